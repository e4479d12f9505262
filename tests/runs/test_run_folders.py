import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.sweeps import make_exploration, make_pretraining, make_run
from toponav.config import SettingsError
from toponav.runs import run_folders
from toponav.runs.run_folders import (
    BrokenRunError,
    find_runs,
    group_runs,
    has_results,
    read_exploration,
    read_pretraining,
    read_table,
    swept_settings,
)

#: What a pre-training says of a maze, and what is none of it.
FIGURES = '{"accuracy": 0.9, "count_1": 3, "accuracy_1": 0.8}'
MAZES = (
    *("3", "{}", "[]", "[3]", '{"a": 3}', '{"a": {}}', f'{{"a": {FIGURES}, "b": 3}}'),
    *(f'{{"a": {FIGURES.replace(*one)}}}' for one in (("0.9", '"x"'), ("0.9", "[1]"))),
    *(f'{{"a": {FIGURES.replace(one, "x")}}}' for one in ("accuracy_1", 'accuracy"')),
    f'{{"a": {FIGURES.replace("0.9", "9" * 400)}}}',
)


def test_runs_are_found_in_all_sweeps_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    for k in ("10", "9", "1"):
        make_run(tmp_path / "deep", "pretrain", f"pairs.k={k}", seed=1)
    make_run(tmp_path, "pretrain", "pairs.k=9", seed=0)
    runs = find_runs(tmp_path)
    found = [(run.given["pairs.k"], run.seed) for run in runs]
    assert found == [("1", 1), ("9", 0), ("9", 1), ("10", 1)]
    assert {run.recipe for run in runs} == {"pretrain"}


def test_runs_deeper_than_sweeps_are_not_looked_for(tmp_path: Path) -> None:
    # Of all sweeps: multirun/explore/<time>/<settings>; with a folder between them.
    make_run(tmp_path / "explore/time/between", "explore", seed=1)
    # Deeper, in a run, and hidden.
    make_run(tmp_path / "explore/time/between/deeper", "explore", seed=2)
    make_run(make_run(tmp_path, "explore", seed=3), "explore", seed=4)
    make_run(tmp_path / ".hidden", "explore", seed=5)
    (tmp_path / "link").symlink_to(tmp_path)
    assert [run.seed for run in find_runs(tmp_path)] == [1, 3]


def test_a_folder_with_more_folders_than_any_sweep_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_folders, "_MOST_FOLDERS", 5)
    for number in range(4):
        (tmp_path / str(number)).mkdir()
    with pytest.raises(SettingsError, match="folder must hold runs of a recipe"):
        find_runs(tmp_path)
    (tmp_path / "4").mkdir()
    with pytest.raises(SettingsError, match=r"a sweep or a run, got .* than 5 f"):
        find_runs(tmp_path)


def test_a_run_is_found_in_its_own_folder(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "explore", "maze=maze1")
    assert [run.folder for run in find_runs(folder)] == [folder]


def test_the_seed_and_a_resumption_are_no_settings(tmp_path: Path) -> None:
    make_run(tmp_path, "explore", "+maze=maze1", "resume='some/run=1'", seed=3)
    (run,) = find_runs(tmp_path)
    assert run.given == {"maze": "maze1"}
    assert run.seed == 3


def test_seeds_of_whole_chains_are_no_settings(tmp_path: Path) -> None:
    for seed in (1, 2):
        words = ("maze=maze1", f"pretraining.seed={seed}")
        make_run(tmp_path, "explore", *words, seed=seed)
    assert swept_settings(find_runs(tmp_path)) == []


def test_swept_settings_are_those_that_differ(tmp_path: Path) -> None:
    make_run(tmp_path, "explore", "scale=smoke", "reward.alpha=0.2", seed=0)
    make_run(tmp_path, "explore", "scale=smoke", "reward.alpha=0.2", seed=1)
    # This one has the value of its config, 0.5.
    make_run(tmp_path, "explore", "scale=smoke", seed=0)
    runs = find_runs(tmp_path)
    names = swept_settings(runs)
    assert names == ["reward.alpha"]
    groups = [
        (settings, [run.seed for run in members])
        for settings, members in group_runs(runs, names)
    ]
    assert groups == [({"reward.alpha": "0.2"}, [0, 1]), ({"reward.alpha": "0.5"}, [0])]


def test_a_group_that_was_not_chosen_is_the_default(tmp_path: Path) -> None:
    make_run(tmp_path, "explore", "maze=maze1")
    make_run(tmp_path, "explore", "reward.alpha=0.5")
    runs = find_runs(tmp_path)
    assert swept_settings(runs) == ["maze"]
    assert sorted(run.setting("maze") for run in runs) == ["default", "maze1"]


def test_a_list_is_written_as_on_a_command_line(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "navigate")
    path = folder / "config/config.yaml"
    path.write_text(yaml.safe_dump({"maze": {"blocked": ["a", "b"], "open": []}}))
    (run,) = find_runs(tmp_path)
    assert run.setting("maze.blocked") == "[a,b]"
    assert run.setting("maze.open") == "[]"


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="folder must hold runs of a recipe, got"):
        find_runs(tmp_path)
    with pytest.raises(SettingsError, match="folder must name the folder of a sweep"):
        find_runs(tmp_path / "nowhere")


def test_columns_are_numbers_where_all_cells_are(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("policy,coverage,seed\nbest,0.5,1\nlast,,2\n")
    columns = read_table(path)
    assert columns["policy"].tolist() == ["best", "last"]
    np.testing.assert_array_equal(columns["coverage"], [0.5, math.nan])
    assert columns["seed"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "has no a.csv"),
        (b"", "has an empty a.csv"),
        (b"x,y\n1,2\n3\n", "has broken rows in its a.csv"),
        (b"x,y\n1,2\n\0\0\0\n", "has broken rows in its a.csv"),
        (b"x,y\n1,\xff2\n", "has a broken a.csv"),
        # More than a cell may have.
        (b"x,y\n1,%b\n" % (b"2" * 200_000), "has a broken a.csv"),
        (b'x\n"1\n2\n', "has a broken a.csv"),
    ],
)
def test_a_broken_table_is_told(
    tmp_path: Path, text: bytes | None, reason: str
) -> None:
    if text is not None:
        (tmp_path / "a.csv").write_bytes(text)
    with pytest.raises(BrokenRunError, match=reason):
        read_table(tmp_path / "a.csv")


def test_a_pretraining_has_its_figures_by_maze(tmp_path: Path) -> None:
    one = read_pretraining(make_pretraining(tmp_path, mazes={"select": 0.9})).T
    assert one["select"]["accuracy"] == 0.9
    # Three pairs at 0.8 and one at 0.4: 2.8 / 4.
    assert one["select"]["locomotion_accuracy"] == pytest.approx(0.7)
    assert one["select"]["waypoint_share_0.9"] == 0.125
    assert one["select"]["tc_accuracy_k4_m5"] == 0.75  # of the last row
    assert math.isnan(one["select"]["through_wall_rate"])
    # The history is over all mazes, so it says nothing on one of two.
    two = make_pretraining(tmp_path, "mazes=[a,b]", mazes={"a": 0.8, "b": 0.7})
    figures = read_pretraining(two).T
    assert [figures[maze]["accuracy"] for maze in "ab"] == [0.8, 0.7]
    assert "tc_accuracy_k4_m5" not in figures.index


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "has no report.json"),
        ('{"mazes": {', "has a broken report.json"),
        ("{}", "has a broken report.json"),
        ("3", "has a broken report.json"),
        ("\xff", "has a broken report.json"),
        ("[" * 100_000, "has a broken report.json"),
        *((f'{{"mazes": {mazes}}}', "has a broken report.json") for mazes in MAZES),
        (f'{{"mazes": {{"a": {FIGURES}}}, "waypoint_share": 3}}', "has a broken rep"),
    ],
)
def test_an_unfinished_pretraining_is_told(
    tmp_path: Path, content: str | None, reason: str
) -> None:
    folder = make_pretraining(tmp_path, mazes={"select": 0.9})
    (folder / "report.json").unlink()
    if content is not None:
        (folder / "report.json").write_text(content, encoding="latin-1")
    with pytest.raises(BrokenRunError, match=reason):
        read_pretraining(folder)


@pytest.mark.parametrize(
    ("files", "found"),
    [
        # A run that was killed before its first checkpoint is started again there.
        (
            ["config/overrides.yaml", "explore.log", "networks.pt", "map_views.bin"],
            False,
        ),
        (["report.json"], False),
        (["report.json", "networks.pt"], True),
        (["checkpoint.pt"], True),
        (["summary.md"], True),
        (["plan.png"], False),
        (["plan.png", "walk.mp4"], True),
    ],
)
def test_a_run_that_is_over_or_can_be_resumed_has_results(
    files: list[str], found: bool, tmp_path: Path
) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert has_results(tmp_path) == found


def test_an_exploration_has_its_episodes_by_policy(tmp_path: Path) -> None:
    found = read_exploration(make_exploration(tmp_path, best=[0.8, 0.95, 1.0]))
    policies = dict(list(found.evaluation.groupby("policy", sort=False)))
    assert list(policies) == ["best", "last", "random"]
    assert policies["best"]["coverage"].tolist() == [0.8, 0.95, 1.0]
    assert policies["best"]["decisions_to_90"].tolist() == [-1, 901, 902]
    assert policies["random"]["coverage"].tolist() == [0.4, 0.5]
    assert len(found.episodes["decisions"]) == 80


def test_a_run_too_short_for_a_whole_episode_is_told(tmp_path: Path) -> None:
    folder = make_exploration(tmp_path, best=[0.95])
    (folder / "episodes.csv").unlink()
    with pytest.raises(BrokenRunError, match="no episode of its training ended"):
        read_exploration(folder)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("decisions_to_90", "x", "has no column 'decisions_to_90' in its evaluation"),
        ("coverage", "covered", "has no column 'intrinsic_return' in its episodes"),
        ("best,|last,", "worst,", "has no evaluation of its best or last policy"),
        ("0.95", "nan", "has evaluation episodes without coverage"),
        ("0.95", "x", "has other than numbers as 'coverage' in its evaluation.csv"),
    ],
)
def test_a_broken_exploration_is_told(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    path = make_exploration(tmp_path, best=[0.95]) / "evaluation.csv"
    path.write_text(re.sub(old, new, path.read_text()))
    with pytest.raises(BrokenRunError, match=reason):
        read_exploration(path.parent)
