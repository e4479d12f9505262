"""Tables of navigators and rivals, by numbers that can be worked out by hand."""

from pathlib import Path

import pytest

from tests.sweeps import make_run, write_table
from toponav.reports import Group, navigate_table, navigation_curves

#: Of an episode: goals, and the decision of the first.
Episode = tuple[int, int]


def navigated(
    tmp_path: Path, row: str, played: dict[str, list[list[Episode]]], **more
) -> Group:
    """Runs of seeds 0, 1, ... with the episodes of each policy."""
    runs = {}
    for seed in range(len(next(iter(played.values())))):
        folder = make_run(tmp_path / row, "navigate", seed=seed)
        rows = [
            {
                "policy": policy,
                "episode": number,
                "goals": goals,
                "reward": 10.0 * goals + 1,
                "first_goal": first,
                "spl": 0.5,
            }
            for policy, seeds in played.items()
            for number, (goals, first) in enumerate(seeds[seed])
        ]
        write_table(folder / "episodes.csv", rows)
        runs[seed] = folder
    return Group(row, "maze1", runs, wanted=len(runs), **more)


OURS = {
    "navigator": [[(4, 100), (2, 300)], [(6, 20), (0, -1)]],
    "oracle": [[(8, 20), (6, 30)], [(8, 10), (10, 40)]],
}
RIVAL = {"navigator": [[(1, 1000), (1, 4000)], [(2, 260), (0, -1)]]}


def test_rows_are_judged_by_what_they_chose(tmp_path: Path) -> None:
    ours = navigated(tmp_path, "ours", OURS, paper={"goals": 1.68})
    rival = navigated(tmp_path, "DQN", RIVAL, against="ours")
    table = navigate_table([ours, rival], draws=50).set_index("row")
    assert list(table.index) == ["ours", "DQN", "oracle"]
    assert [one.value for one in table["goals"]] == [3, 1, 8]
    assert [one.value for one in table["reward"]] == [31, 11, 81]
    # The middle half of 0, 2, 4, 6.
    assert table.loc["ours", "goals (IQM)"].value == 3
    assert list(table["of the oracle (%)"]) == [37.5, 12.5, 100]
    within = [table[f"success {time} (%)"] for time in (250, 500, 1250, 5000)]
    assert [one["ours"].value for one in within] == [50, 75, 75, 75]
    assert [one["DQN"].value for one in within] == [0, 25, 50, 75]
    # 1 - 4, 1 - 2, 2 - 6 and 0 - 0.
    assert table.loc["DQN", "difference (goals)"].value == -2
    assert table.loc["ours", "paper: goals"] == 1.68
    assert list(table["runs"]) == ["2 of 2", "2 of 2", "-"]


def test_nobody_is_asked_for_more_decisions_than_an_episode_has(tmp_path: Path) -> None:
    groups = [navigated(tmp_path, "ours", OURS), navigated(tmp_path, "DQN", RIVAL)]
    for group in groups:
        for folder in group.runs.values():
            (folder / "config/config.yaml").write_text("maze: {episode_length: 1000}\n")
    table = navigate_table(groups, draws=50)
    within = [name for name in table if name.startswith("success")]
    assert within == ["success 250 (%)", "success 500 (%)"]
    (axes,) = navigation_curves(groups, title="some").axes
    ends = [line.get_xdata()[-1] for line in axes.lines]
    assert ends == pytest.approx([1000] * 3)


def test_a_row_without_runs_is_there_and_empty(tmp_path: Path) -> None:
    ours = navigated(tmp_path, "ours", OURS)
    none = Group("DQN", "maze1", {}, wanted=2, against="ours")
    table = navigate_table([ours, none], draws=50).set_index("row")
    assert table.loc["DQN", "runs"] == "0 of 2"
    assert str(table.loc["DQN", "goals"]) == "nan"
    figure = navigation_curves([ours, none], title="some")
    assert len(figure.axes[0].lines) == 2


def test_the_figure_has_a_curve_a_policy(tmp_path: Path) -> None:
    groups = [navigated(tmp_path, "ours", OURS), navigated(tmp_path, "DQN", RIVAL)]
    (axes,) = navigation_curves(groups, title="some").axes
    labels = [line.get_label() for line in axes.lines]
    assert labels == ["ours (2 runs)", "DQN (2 runs)", "oracle (2 runs)"]
    # After 5000 decisions three of ours in four, and all of the oracle's.
    ends = [line.get_ydata()[-1] for line in axes.lines]
    assert ends == pytest.approx([75, 75, 100])
    assert axes.get_xlabel() == "decisions of an episode"
