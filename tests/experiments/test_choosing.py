"""Settings that are drawn by chance are tried elsewhere, and the best ones taken."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.experiments.planning import reproducing
from tests.experiments.test_found_runs import save
from tests.sweeps import make_exploration, write_table
from toponav.config import ReproduceConfig, RowConfig, SettingsError
from toponav.experiments import (
    Cell,
    Choice,
    announce,
    choice_sentences,
    choose,
    make_groups,
    plan_cells,
    plan_tries,
    undrawn_sentences,
    with_choices,
)
from toponav.experiments.found_runs import plain

MAZES = ["select", "generated 1"]


def small(settings: ReproduceConfig) -> ReproduceConfig:
    """Three rows: one that draws, one that follows it, and one of its own draws."""
    rows = [
        RowConfig(label="random", overrides=["reward=random"]),
        RowConfig(
            label="random, noise",
            overrides=["reward=random", "collect.noisy_tv=true"],
            against="random",
            choice_of="random",
        ),
        RowConfig(
            label="truth",
            overrides=["reward=coverage"],
            drawn=["loss.gamma=${log_uniform:0.9,0.99}"],
            against="random",
        ),
    ]
    return replace(settings, experiment=replace(settings.experiment, rows=rows))


def finish(cell: Cell, coverage: float) -> None:
    """The tables of a run whose last policy covers so much of its maze."""
    best = [coverage + 0.1]
    made = make_exploration(cell.folder / "made", seed=cell.seed, best=best)
    save(cell.folder, plain(cell.config))
    for table in made.glob("*.csv"):
        table.rename(cell.folder / table.name)
    row: dict[str, object] = {"decisions": cell.config.collect.decisions}
    write_table(cell.folder / "metrics.csv", [row])


@pytest.fixture
def settings(tmp_path: Path):
    words = ["reproduce=smoke", f"runs={tmp_path}", "tries=2", "most_mazes=1"]
    with reproducing(*words) as given:
        yield small(given)


def test_every_draw_is_tried_in_all_mazes_of_the_choice(
    settings: ReproduceConfig,
) -> None:
    tries = plan_tries(settings)
    # Two rows choose; two mazes; two draws.
    assert [(cell.row, cell.maze, cell.seed) for cell in tries] == [
        (row, maze, seed)
        for row in ("random", "truth")
        for maze in MAZES
        for seed in (0, 1)
    ]
    rates = [cell.config.loss.lr for cell in tries]
    assert rates[0] == rates[2] != rates[1]
    assert all(1e-4 <= rate <= 5e-3 for rate in rates[:4])
    assert rates[4] == rates[5]
    assert 0.9 <= tries[4].config.loss.gamma <= 0.99
    assert plan_tries(replace(settings, tries=0)) == []
    # Whatever the seeds of the rows are, the draws are the same.
    later = plan_tries(replace(settings, first_seed=5))
    assert [cell.key for cell in later] == [cell.key for cell in tries]
    # A row that follows another one makes that one choose.
    alone = plan_tries(replace(settings, rows=["random, noise"]))
    assert [cell.key for cell in alone] == [cell.key for cell in tries[:4]]


def test_the_draw_that_covers_most_in_the_mean_is_taken(
    settings: ReproduceConfig,
) -> None:
    tries = plan_tries(settings)
    random, truth = tries[:4], tries[4:]
    # In the mean over the mazes: (0.9 + 0.3) / 2 = 0.6, (0.6 + 0.7) / 2 = 0.65.
    for cell, coverage in zip(random, (0.9, 0.6, 0.3, 0.7), strict=True):
        finish(cell, coverage)
    # The first draw is not made in the second maze, and does not count.
    for cell, coverage in zip(
        (truth[0], truth[1], truth[3]), (1.0, 0.5, 0.5), strict=True
    ):
        finish(cell, coverage)
    choices = choose(settings, tries)
    assert [(one.row, one.tries) for one in choices] == [("random", 2), ("truth", 1)]
    assert [one.score for one in choices] == pytest.approx([65, 50])
    best = random[1].config.loss
    assert choices[0].words == (
        f"loss.lr={best.lr}",
        f"loss.entropy_coeff={best.entropy_coeff}",
    )
    said = choice_sentences(settings, choices)
    assert said[0] == (
        f"random: {' '.join(choices[0].words)}, the best of 2 random draws in select, "
        "generated 1 (65.0 % covered)"
    )
    assert len(said) == 2

    chosen = with_choices(settings, choices)
    cells = plan_cells(chosen)
    assert [(cell.row, cell.maze) for cell in cells] == [
        ("random", "maze1"),
        ("random, noise", "maze1"),
        ("truth", "maze1"),
    ]
    assert [cell.config.loss.lr for cell in cells[:2]] == [best.lr, best.lr]
    assert cells[2].config.loss.gamma == truth[1].config.loss.gamma
    assert cells[2].config.loss.lr not in (best.lr, random[0].config.loss.lr)
    assert [one.against for one in make_groups(chosen, cells)] == [
        None,
        "random",
        "random",
    ]


def test_a_reader_is_told_that_nothing_was_drawn(settings: ReproduceConfig) -> None:
    assert undrawn_sentences(settings) == []
    none = replace(settings, tries=0)
    assert undrawn_sentences(none) == [
        "tries=0: no row draws settings by chance; each has those that it names."
    ]
    # At the paper's scale each seed is a draw.
    assert undrawn_sentences(replace(none, scale="paper")) == []
    rows = [replace(row, drawn=[]) for row in none.experiment.rows]
    fixed = replace(none.experiment, rows=rows, drawn=[])
    assert undrawn_sentences(replace(none, experiment=fixed)) == []


def test_a_row_without_a_choice_is_left_out_and_named(
    settings: ReproduceConfig,
) -> None:
    tries = plan_tries(settings)
    for cell in tries[4:]:
        finish(cell, 0.5)
    choices = choose(settings, tries)
    chosen = with_choices(settings, choices)
    rows = chosen.experiment.rows
    assert [(row.label, row.against) for row in rows] == [("truth", None)]
    assert choice_sentences(settings, choices)[-1] == (
        "missing: random: its settings are not chosen yet"
    )


def test_the_run_that_comes_first_has_the_chosen_settings(
    settings: ReproduceConfig,
) -> None:
    row = RowConfig(
        label="tuned",
        overrides=["reward=random", "init_policy={first}"],
        first=["maze=select", "reward=random"],
        choice_of="random",
    )
    rows = [settings.experiment.rows[0], row]
    settings = replace(settings, experiment=replace(settings.experiment, rows=rows))
    tries = plan_tries(settings)
    for cell in tries:
        finish(cell, 0.5)
    choices = choose(settings, tries)
    cells = plan_cells(with_choices(settings, choices))
    rate = tries[0].config.loss.lr
    assert [cell.config.loss.lr for cell in cells] == [rate, rate]
    assert cells[1].first is not None
    assert cells[1].first.config.loss.lr == rate


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"choose_on": []},
            "experiment.choose_on must name mazes if settings are drawn",
        ),
        ({"recipe": "pretrain"}, "experiment.drawn must be empty unless its recipe is"),
    ],
)
def test_draws_that_nobody_could_try_are_refused(
    settings: ReproduceConfig, change: dict[str, object], sentence: str
) -> None:
    with pytest.raises(SettingsError, match=sentence):
        replace(settings.experiment, **change)


def test_the_choice_of_a_row_that_is_not_there_is_refused(
    settings: ReproduceConfig,
) -> None:
    rows = [RowConfig(label="one", overrides=[], choice_of="two")]
    with pytest.raises(SettingsError, match="'one' takes its drawn settings from"):
        replace(settings.experiment, rows=rows)


@pytest.fixture
def navigating(tmp_path: Path):
    words = ["experiment=table8", "reproduce=smoke", f"runs={tmp_path}", "tries=2"]
    with reproducing(*words, "most_mazes=1", "rows=[DQN]") as given:
        yield given


def test_rivals_are_tried_as_often_as_ours_by_what_their_policies_get(
    navigating: ReproduceConfig,
) -> None:
    tries = plan_tries(navigating)
    # Two rows choose, DQN and ours, whose map it plays over; two mazes; two draws.
    assert [(cell.row, cell.maze, cell.seed) for cell in tries] == [
        (row, maze, seed)
        for row in ("ours", "DQN")
        for maze in MAZES
        for seed in (0, 1)
    ]
    assert {cell.recipe for cell in tries} == {"explore"}
    ours, dqn = tries[:4], tries[4:]
    assert {cell.config.reward.name for cell in ours} == {"novelty"}
    assert {cell.config.loss.name for cell in dqn} == {"dqn"}
    assert all(cell.config.maze.goal and cell.config.maze.apples == 3 for cell in dqn)
    shares = [cell.config.loss.epsilon for cell in dqn]
    assert shares[:2] == shares[2:]
    assert shares[0] != shares[1]
    assert all(0.02 <= share <= 0.2 for share in shares)

    # By what is covered the first draw is best, by what is paid (100 and the seed in
    # every episode of both policies, see make_exploration) the second.
    for cell in tries:
        finish(cell, 0.8 - cell.seed / 2)
    choices = choose(navigating, tries)
    assert [(one.row, one.measure) for one in choices] == [
        ("ours", "% covered"),
        ("DQN", "reward of an episode"),
    ]
    assert [one.score for one in choices] == pytest.approx([80, 101])

    chosen = with_choices(navigating, choices)
    mapped, rival = plan_cells(chosen)
    assert mapped.first.key == rival.first.key
    assert rival.first.config.loss.lr == ours[0].config.loss.lr
    assert rival.policy.config.loss.epsilon == dqn[1].config.loss.epsilon
    assert rival.policy.config.maze.name == "maze1"
    said = choice_sentences(navigating, choices)
    assert said[1].endswith(" (101.0 reward of an episode)")


def test_a_rival_waits_for_the_choice_of_its_map(navigating: ReproduceConfig) -> None:
    tries = plan_tries(navigating)
    for cell in tries:
        if cell.row == "DQN":
            finish(cell, 0.5)
    choices = choose(navigating, tries)
    assert [one.row for one in choices] == ["DQN"]
    assert plan_cells(with_choices(navigating, choices)) == []
    assert announce(navigating, []) == "table8: no row has its settings chosen yet"
    assert choice_sentences(navigating, choices)[1:] == [
        "missing: ours: its settings are not chosen yet"
    ]


def test_what_is_chosen_comes_after_what_the_scale_sets(tmp_path: Path) -> None:
    words = ["experiment=table8", f"runs={tmp_path}", "seeds=1", "most_mazes=1"]
    with reproducing(*words, "rows=['Nav A3C']") as laptop:
        plain = plan_cells(laptop)[-1].policy.config.loss
        assert (plain.lr, plain.entropy_coeff) == (0.0005, 0.01)
        drawn = ("loss.lr=0.003", "loss.entropy_coeff=0.004")
        choices = [Choice(row, drawn, 1.0, "", 2) for row in ("ours", "Nav A3C")]
        chosen = plan_cells(with_choices(laptop, choices))[-1].policy.config.loss
        assert (chosen.lr, chosen.entropy_coeff) == (0.003, 0.004)
        assert (chosen.rollout, chosen.eps) == (20, 1e-5)


def test_tries_of_novelty_serve_tables_3_and_8(tmp_path: Path) -> None:
    keys = []
    for name, row in (("table3", "novelty"), ("table8", "ours")):
        words = [f"experiment={name}", f"runs={tmp_path}", f"rows=[{row}]", "tries=1"]
        with reproducing(*words) as settings:
            keys.append([cell.key for cell in plan_tries(settings)])
    # One draw in two mazes.
    assert len(keys[0]) == 2
    assert keys[0] == keys[1]
