"""Decisions that the networks of a run learned from before it."""

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from toponav.builders import pretraining_decisions
from toponav.config import ExploreConfig
from toponav.experiments.cells import Cell
from toponav.methods import REWARDS
from toponav.runs import write_text

# Kept with a run's tables, which outlive the pre-training that says it.
_FILE = "decisions_before.json"


def explore_settings(cell: Cell) -> ExploreConfig:
    """The settings of a cell that explores."""
    found: Any = OmegaConf.to_object(cell.config)
    assert isinstance(found, ExploreConfig)
    return found


def decisions_before(cell: Cell) -> float:
    """As the run's kept copy says, else as the runs before it do; NaN if none does."""
    if cell.recipe != "explore":
        return 0.0
    if cell.kept is not None:
        # A damaged file is as good as none.
        damaged = (ValueError, KeyError, TypeError, RecursionError, OverflowError)
        with suppress(OSError, *damaged):
            return float(json.loads((cell.kept / _FILE).read_text())["decisions"])
    config, first = explore_settings(cell), cell.first
    if not REWARDS[config.reward.name].needs_networks and not config.pretrained:
        return 0.0
    if first is None or not config.pretrained:
        return pretraining_decisions(config)
    # The networks of the run that came first: those of its own pre-training, which its
    # settings do not name.
    learned = explore_settings(first)
    more = learned.collect.decisions if learned.online.learn else 0
    return decisions_before(first) + more


def keep_decisions_before(cell: Cell, folder: Path) -> None:
    """Write them into a folder, where they are known and not of the settings alone."""
    decisions = decisions_before(cell)
    if decisions and math.isfinite(decisions) and not (folder / _FILE).is_file():
        write_text(folder / _FILE, json.dumps({"decisions": decisions}) + "\n")
