"""An experiment becomes runs: which there are, and which settings they have."""

import copy
import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.experiments.planning import CONF, reproducing
from tests.experiments.test_choosing import finish
from tests.experiments.test_found_runs import save
from toponav.config import ExperimentConfig, ReproduceConfig, RowConfig, SettingsError
from toponav.experiments import (
    Cell,
    announce,
    missing_cells,
    plan_cells,
    untested_sentences,
)
from toponav.experiments.cells import rows_of
from toponav.experiments.found_runs import plain
from toponav.experiments.making import run_words
from toponav.reports import SCRIPTED, require_columns

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
#: Rows that were composed already: several tables share them.
SEEN: set[tuple[str, ...]] = set()


def with_rows(settings: ReproduceConfig, rows: list[RowConfig]) -> ExperimentConfig:
    """The experiment with other rows."""
    return replace(settings.experiment, rows=rows)


def kind(row: RowConfig) -> tuple[str, ...]:
    """What the row chooses and sets; the values of settings do not count."""
    words = [*row.first, *row.policy, *row.overrides, *row.laptop_overrides]
    return tuple(re.sub(r"(\w\.\w+)=.*", r"\1", word) for word in words)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_row_of_every_experiment_is_a_run(name: str, tmp_path: Path) -> None:
    with reproducing(
        f"experiment={name}", "reproduce=smoke", f"runs={tmp_path}"
    ) as all_:
        experiment = all_.experiment
        require_columns(experiment)
        assert set(experiment.scripted) <= set(SCRIPTED)
        mazes = {
            one for row in experiment.rows for one in (row.mazes or experiment.mazes)
        }
        names = {one.partition(":")[0] for one in mazes}
        labels = {row.label for row in experiment.rows}
        assert {one.row for one in experiment.paper} <= labels
        assert {one.maze for one in experiment.paper} <= names
        new = {
            kind(row): replace(row, against=None, choice_of=None, passed=True)
            for row in experiment.rows
        }
        rows = [row for key, row in new.items() if key not in SEEN]
        SEEN.update(new)
        cells = plan_cells(
            replace(all_, experiment=replace(experiment, rows=rows), rows=[])
        )
        assert len(cells) == len(rows)


def test_seeds_and_mazes_are_cells_of_their_own(tmp_path: Path) -> None:
    words = ["reproduce=smoke", f"runs={tmp_path}", "seeds=2", "most_mazes=2"]
    with reproducing(*words, "rows=[random reward]", by_hydra=True) as settings:
        cells = plan_cells(settings)
        assert [(cell.maze, cell.seed) for cell in cells] == [
            ("maze1", 0),
            ("maze1", 1),
            ("maze2", 0),
            ("maze2", 1),
        ]
        assert len({cell.key for cell in cells}) == 4
        assert cells[0].folder == tmp_path / "explore" / f"maze1-smoke-{cells[0].key}"
        assert cells[1].config.seed == 1
        assert "seed=1" in run_words(cells[1])
        # A run that is there already is found, whatever its number of threads. Four of
        # 15 s each by the figures in conf, and no pre-training.
        save(tmp_path / "by-hand", plain(cells[1].config) | {"threads": 7})
        again = plan_cells(settings)
        assert again[1].folder == tmp_path / "by-hand"
        assert announce(settings, again) == (
            "table3: 4 of 4 runs are missing; about 1.0 minutes, one at a time (an "
            "estimate from figures in conf/reproduce)"
        )


def test_the_seeds_of_rows_can_be_fresh_ones(tmp_path: Path) -> None:
    words = ["reproduce=smoke", f"runs={tmp_path}", "seeds=2", "first_seed=7"]
    with reproducing(*words, "rows=[random reward]") as settings:
        cells = plan_cells(settings)
        assert [cell.seed for cell in cells] == [7, 8]
        assert [cell.config.seed for cell in cells] == [7, 8]
        # Each is the run that more seeds from 0 on would have.
        many = plan_cells(replace(settings, seeds=9, first_seed=0))
        assert [cell.key for cell in cells] == [cell.key for cell in many[7:]]


def test_a_run_can_start_from_another(tmp_path: Path) -> None:
    words = ["reproduce=smoke", f"runs={tmp_path}", "rows=[random reward]", "seeds=2"]
    with reproducing(*words) as settings:
        row = RowConfig(
            label="random reward",
            overrides=["reward=random", "pretrained={first}"],
            first=["maze=select", "reward=novelty"],
        )
        experiment = replace(settings.experiment, rows=[row])
        cells = plan_cells(replace(settings, experiment=experiment))
        firsts = [cell.first for cell in cells]
        assert [one.seed for one in firsts] == [0, 1]
        assert [one.config.maze.name for one in firsts] == ["select", "select"]
        assert cells[1].config.pretrained == str(firsts[1].folder)
        assert f"pretrained='{firsts[1].folder}'" in run_words(cells[1])
        wanted = [firsts[0], cells[0], firsts[1], cells[1]]
        assert missing_cells(cells) == wanted
        # The same run once the first one is there, wherever that is.
        save(tmp_path / "elsewhere", plain(firsts[1].config))
        again = plan_cells(replace(settings, experiment=experiment))
        assert again[1].first.folder == tmp_path / "elsewhere"
        assert again[1].key == cells[1].key


def test_the_main_job_is_a_run_of_a_row_without_a_map(tmp_path: Path) -> None:
    with reproducing("reproduce=smoke", f"runs={tmp_path}") as settings:
        first = RowConfig(
            label="tuned",
            overrides=["reward=random", "pretrained={first}", "map.grow=false"],
            first=["maze=select", "reward=novelty", "map.grow=false"],
        )
        plain_row = RowConfig(
            label="novelty", overrides=["reward=novelty", "map.grow=false"]
        )
        rows = [plain_row, replace(first, against="novelty")]
        given = replace(settings, most_mazes=1, experiment=with_rows(settings, rows))
        novelty, tuned = plan_cells(given)

        def make(cell: Cell, name: str, *words: str) -> Path:
            """A run with a map, whose other settings are those of a cell."""
            config = copy.deepcopy(cell.config)
            config.map.grow, config.locomotion.learn = True, None
            config.merge_with_dotlist([*words])
            made = replace(cell, folder=tmp_path / name, config=config)
            finish(made, 0.5)
            (made.folder / "networks.pt").touch()
            return made.folder

        for number, words in enumerate((["seed=1"], ["map.tc_threshold=0.1"])):
            make(novelty, f"other {number}", *words)
        # One that others start from is known to them by its own settings.
        make(tuned.first, "select")
        main = make(novelty, "main")
        (tmp_path / "main" / "metrics.csv").rename(tmp_path / "metrics.csv")
        assert plan_cells(given)[0].folder == novelty.folder
        (tmp_path / "metrics.csv").rename(tmp_path / "main" / "metrics.csv")
        found, later = plan_cells(given)
        assert (found.folder, found.key) == (main, novelty.key)
        assert found.results == main
        assert later.first.folder == tuned.first.folder
        # One that was made for the row comes first.
        finish(novelty, 0.6)
        assert plan_cells(given)[0].folder == novelty.folder


@pytest.mark.parametrize(
    ("name", "rows", "firsts", "policies"),
    [
        # Rows of one maze; explorations of select, by novelty and ICM, that the
        # fine-tuned ones begin with.
        ("table5", 4, 2, 0),
        ("table6", 6, 2, 0),
        # Ours and one more, over the map of one exploration, and four rivals.
        ("table8", 6, 1, 4),
        ("table9", 6, 1, 4),
    ],
)
def test_a_plan_has_each_run_once(
    name: str, rows: int, firsts: int, policies: int, tmp_path: Path
) -> None:
    words = [f"experiment={name}", "reproduce=smoke", f"runs={tmp_path}", "seeds=2"]
    with reproducing(*words) as settings:
        cells = plan_cells(settings)
        # Each with two seeds.
        assert len({cell.key for cell in cells}) == len(cells) == 2 * rows
        assert len({cell.first.key for cell in cells if cell.first}) == 2 * firsts
        assert len({cell.policy.key for cell in cells if cell.policy}) == 2 * policies
        total = 2 * (rows + firsts + policies)
        assert len(missing_cells(cells)) == total
        assert announce(settings, cells).startswith(
            f"{name}: {total} of {total} runs are missing"
        )


def test_a_row_that_has_not_passed_is_made_by_name_alone() -> None:
    with reproducing("experiment=table8", "reproduce=smoke") as settings:
        rows = [
            replace(row, passed=row.label != "DRQN") for row in settings.experiment.rows
        ]
        settings = replace(settings, experiment=replace(settings.experiment, rows=rows))
        named = replace(settings, rows=["DRQN", "ours"])
        assert "DRQN" not in [row.label for row in rows_of(settings)]
        assert [row.label for row in rows_of(named)] == ["ours", "DRQN"]
        (said,) = untested_sentences(settings)
        assert said.startswith("'DRQN' is left out: its method has not passed")
        assert "rows=['DRQN']" in said
        assert untested_sentences(named) == []


@pytest.mark.parametrize("row", ["DQN", "DRQN", "Nav A3C", "Nav A3C + D2L"])
@pytest.mark.parametrize("scale", ["laptop", "paper"])
def test_what_trains_a_rival_is_valid_and_has_as_many_decisions(
    row: str, scale: str, tmp_path: Path
) -> None:
    words = ["experiment=table8", f"reproduce={scale}", f"runs={tmp_path}", "seeds=2"]
    with reproducing(*words, "most_mazes=1") as settings:
        known = settings.experiment.rows
        rows = [replace(one, against=None, passed=True) for one in known]
        rows = [one for one in rows if one.label == row]
        experiment = replace(settings.experiment, rows=rows)
        cells = plan_cells(replace(settings, experiment=experiment))
        trained = [plain(cell.policy.config) for cell in cells]
        # 400,000 + 100,000 of ours at the laptop scale, 10 + 2.5 millions at the other.
        decisions = {"laptop": 500_000, "paper": 12_500_000}[scale]
        assert [one["collect"]["decisions"] for one in trained] == [decisions] * 2
        # At the paper's scale each seed is a draw.
        rates = {one["loss"]["lr"] for one in trained}
        assert len(rates) == {"laptop": 1, "paper": 2}[scale]
        assert all(1e-4 <= rate <= 5e-3 for rate in rates)


def test_trpo_has_its_own_numbers_at_the_scale_of_the_paper(tmp_path: Path) -> None:
    words = ["experiment=table3", "reproduce=paper", f"runs={tmp_path}", "seeds=2"]
    with reproducing(*words, "most_mazes=1", "rows=[EX2 on TRPO]") as settings:
        losses = [plain(cell.config)["loss"] for cell in plan_cells(settings)]
    # Of Fu et al., not what the others draw; the bound is drawn in its place.
    assert [one["entropy_coeff"] for one in losses] == [1e-5] * 2
    first, second = (one["max_kl"] for one in losses)
    assert first != second


def test_what_a_recipe_refuses_is_one_sentence(tmp_path: Path) -> None:
    with reproducing(
        "reproduce=smoke", "explore_overrides=['collect.envs=0']"
    ) as settings:
        with pytest.raises(SettingsError) as error:
            plan_cells(replace(settings, runs=str(tmp_path)))
        assert str(error.value) == (
            "row 'novelty' must have settings of explore: collect.envs must be at "
            "least 1, got 0"
        )


def test_draws_at_the_scale_of_the_paper_differ_by_seed(tmp_path: Path) -> None:
    words = [
        "reproduce=paper",
        f"runs={tmp_path}",
        "rows=[RND]",
        "seeds=2",
        "most_mazes=1",
    ]
    with reproducing(*words) as settings:
        one, two = (plain(cell.config)["loss"]["lr"] for cell in plan_cells(settings))
        assert 1e-4 <= one <= 5e-3
        assert one != two


def test_a_rival_navigates_once_it_is_trained_on_the_map_of_ours(
    tmp_path: Path,
) -> None:
    words = ["experiment=table9", "reproduce=smoke", f"runs={tmp_path}"]
    words += ["most_mazes=2", "rows=[DQN]", "navigate_overrides=['evaluate.slow=7']"]
    words += ["explore_overrides=['report.best_of=3']"]
    with reproducing(*words) as settings:
        cells = plan_cells(settings)
        assert [(cell.row, cell.maze) for cell in cells] == [
            (row, maze)
            for row in ("ours", "DQN")
            for maze in ("nothing closed", "a closed")
        ]
        ours, shut, dqn, dqn_shut = cells
        assert [cell.recipe for cell in (dqn, *dqn.before)] == [
            *("navigate", "explore", "explore")
        ]
        # Both are made in the open maze, once for all rows and closed slots.
        assert {cell.first.key for cell in cells} == {ours.first.key}
        assert ours.policy is None
        assert dqn.policy.key == dqn_shut.policy.key != ours.first.key
        trained = dqn.policy.config
        assert (trained.loss.name, trained.reward.name) == ("dqn", "extrinsic")
        assert (trained.maze.goal, list(trained.maze.blocked)) == (True, [])
        assert (trained.report.best_of, ours.first.config.report.best_of) == (2, 3)
        assert dqn.config.run == str(ours.first.folder)
        assert dqn.config.navigator.policy == str(dqn.policy.folder)
        assert list(dqn_shut.config.maze.blocked) == ["a"]
        assert dqn.config.evaluate.slow == 7
        assert len({cell.key for cell in cells}) == 4
        said = run_words(dqn)
        assert f"run='{ours.first.folder}'" in said
        assert f"navigator.policy='{dqn.policy.folder}'" in said
        assert dqn.folder.parent == tmp_path / "navigate"
        assert missing_cells(cells) == [ours.first, ours, shut, dqn.policy, *cells[2:]]
        # Six runs of 15 s, and a pre-training.
        assert announce(settings, cells).startswith(
            "table9: 6 of 6 runs are missing, and 1 pre-trainings; about 1.8 minutes"
        )
        # Elsewhere they are the same.
        save(tmp_path / "by-hand", plain(dqn.policy.config))
        again = plan_cells(settings)
        assert again[2].policy.folder == tmp_path / "by-hand"
        assert again[2].key == dqn.key
