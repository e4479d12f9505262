"""What a table is made of: cells of its mazes, and what networks learned from."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tests.experiments.planning import reproducing
from tests.experiments.test_choosing import finish
from toponav.builders import pretraining_folder
from toponav.config import ReproduceConfig, RowConfig, SettingsError
from toponav.experiments import make_groups, plan_cells
from toponav.experiments.decisions_before import explore_settings

GYM = ["world=gym", "world.id=tests.foreign_world:ForeignWorld-v0"]


def with_rows(settings: ReproduceConfig, rows: Sequence[RowConfig]) -> ReproduceConfig:
    experiment = replace(settings.experiment, rows=list(rows))
    return replace(settings, experiment=experiment, rows=[])


def words_for(folder: Path) -> list[str]:
    table = folder / "table"
    return ["reproduce=smoke", f"runs={folder}", f"folder={table}", "most_mazes=1"]


def test_closed_cells_are_none_that_an_episode_could_visit(tmp_path: Path) -> None:
    rows = [
        RowConfig(label="open", overrides=["reward=random"]),
        RowConfig(label="shut", overrides=["reward=random", "maze.blocked=[a]"]),
    ]
    with reproducing(*words_for(tmp_path)) as settings:
        given = with_rows(settings, rows)
        groups = make_groups(given, plan_cells(given))
    # A reward of 1 for each cell: 100 % are 51 of maze1, or one less.
    assert [one.cells for one in groups] == [51, 50]


@pytest.mark.parametrize("made", [(0, 1), (1,)])
def test_one_seed_hides_not_what_the_networks_of_others_learned_from(
    made: tuple[int, ...], tmp_path: Path
) -> None:
    own = f"pretraining.folder={tmp_path}/pretrain"
    row = RowConfig(label="novelty", overrides=["reward=novelty", own])
    with reproducing(*words_for(tmp_path), "seeds=2") as settings:
        given = with_rows(settings, [row])
        cells = plan_cells(given)
        for number in made:
            finish(cells[number], 0.5)
        # Of the first seed the pre-training is gone, or its run is missing.
        config = pretraining_folder(explore_settings(cells[1])) / "config/config.yaml"
        config.parent.mkdir(parents=True)
        config.write_text("collect: {decisions: 98304}\n")
        (group,) = make_groups(given, cells)
    assert (len(group.runs), group.before) == (len(made), 98304)


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("table3", RowConfig(label="pong", overrides=["reward=random", *GYM])),
        ("table8", RowConfig(label="pong", first=["{maze}", *GYM])),
    ],
)
def test_a_world_without_a_plan_is_refused(
    name: str, row: RowConfig, tmp_path: Path
) -> None:
    sentence = "row 'pong' must have world=maze, to be judged by its plan, got world="
    with reproducing(f"experiment={name}", *words_for(tmp_path)) as settings:
        given = with_rows(settings, [row])
        with pytest.raises(SettingsError, match=re.escape(f"{sentence}gym")):
            plan_cells(given)
