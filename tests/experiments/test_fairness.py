"""Methods of a table get equally many decisions, and seeds networks of their own."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.experiments.planning import reproducing
from toponav.builders import pretraining_folder
from toponav.config import ReproduceConfig
from toponav.experiments import Cell, plan_cells
from toponav.experiments.decisions_before import decisions_before, explore_settings

#: Rows of each way to come by networks or none.
ROWS = {
    "table3": ["novelty", "ICM", "VIME on TRPO", "TRPO without reward"],
    "table6": ["extrinsic on the embedding", "extrinsic"],
}
#: Decisions of exploring and pre-training together.
ALL = {"laptop": 500_000, "paper": 12_500_000}


def pretend_pretraining(cell: Cell, settings: ReproduceConfig) -> None:
    """The settings file of the pre-training that an exploration would make."""
    config = pretraining_folder(explore_settings(cell)) / "config" / "config.yaml"
    config.parent.mkdir(parents=True, exist_ok=True)
    decisions = {"laptop": 100_000, "paper": 2_500_000}[settings.scale]
    config.write_text(yaml.safe_dump({"collect": {"decisions": decisions}}))


@pytest.mark.slow
# At the paper's scale the networks of select have gone on training there.
@pytest.mark.parametrize(
    ("name", "scale"), [*((name, "laptop") for name in ROWS), ("table3", "paper")]
)
def test_rows_get_as_many_decisions_as_each_other(
    name: str, scale: str, tmp_path: Path
) -> None:
    words = [f"experiment={name}", f"reproduce={scale}", f"runs={tmp_path}"]
    with reproducing(*words, "most_mazes=1", "seeds=1") as settings:
        own = f"pretraining.folder={tmp_path}/pretrain"
        rows = [
            replace(
                row,
                overrides=[*row.overrides, own],
                first=[*row.first, own] if row.first else [],
                against=None,
                choice_of=None,
            )
            for row in settings.experiment.rows
            if row.label in ROWS[name]
        ]
        experiment = replace(settings.experiment, rows=rows, drawn=[])
        settings = replace(settings, experiment=experiment, rows=[])
        cells = plan_cells(settings)
        assert {cell.row for cell in cells} == set(ROWS[name])
        for cell in cells:
            for one in (cell, *cell.before):
                pretend_pretraining(one, settings)
            explored = explore_settings(cell)
            # Those of select, where a policy began, are said in the table's remarks.
            all_in = explored.collect.decisions + decisions_before(cell)
            assert all_in == ALL[scale], cell.row


def test_seeds_have_networks_of_their_own(tmp_path: Path) -> None:
    words = ["experiment=table3", "reproduce=smoke", f"runs={tmp_path}", "seeds=2"]
    with reproducing(*words, "most_mazes=1", "rows=[novelty]") as settings:
        first, second = map(explore_settings, plan_cells(settings))
    assert (first.pretraining.seed, second.pretraining.seed) == (0, 1)
    assert pretraining_folder(first) != pretraining_folder(second)
