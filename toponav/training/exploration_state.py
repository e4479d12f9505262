"""`ExplorationState`: what a run of exploration has done so far, and its checkpoint."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from toponav.builders import Consumer
from toponav.config import ExploreCollectConfig, SettingsError
from toponav.runs import CHECKPOINT_FILE, load_checkpoint, save_atomically
from toponav.training.episode_log import Row, mean_of

#: The file in a run folder that holds the policy to use.
POLICY_FILE = "policy.pt"
#: Policies that see nothing: blind baselines.
BASELINES = ("random", "sticky")
_KIND, _VERSION = "toponav exploration", 2


@dataclass
class ExplorationState:
    """Counters and tables of a run.

    Args:
        decisions: learned from, over all environments.
        seconds: of exploring; pre-training is not in it.
        progress: how much of the run is over, in [0, 1].
        versions: newest version that was published, by name.
        history: rows of ``metrics.csv``.
        evaluations: rows of ``evaluation.csv``.
    """

    decisions: int = 0
    seconds: float = 0.0
    progress: float = 0.0
    versions: dict[str, int] = field(default_factory=dict)
    history: list[Row] = field(default_factory=list)
    evaluations: list[Row] = field(default_factory=list)

    def count(
        self, decisions: int, seconds: float, collect: ExploreCollectConfig
    ) -> None:
        """Count a batch.

        Args:
            decisions: of the batch.
            seconds: of the run so far.
            collect: says when a run is over, by decisions or by the clock.
        """
        self.decisions += decisions
        self.seconds = seconds
        by_clock = seconds / (60 * collect.minutes) if collect.minutes else 0.0
        self.progress = min(1.0, max(self.decisions / collect.decisions, by_clock))

    @property
    def baselines(self) -> dict[str, float]:
        """Mean coverage of the blind baselines, by name; empty where it is unknown."""
        rows = [row for row in self.evaluations if row["policy"] in BASELINES]
        names = dict.fromkeys(str(row["policy"]) for row in rows if "coverage" in row)
        return {
            name: mean_of([row for row in rows if row["policy"] == name], "coverage")
            for name in names
        }


def save_exploration(
    folder: Path, state: ExplorationState, consumers: Mapping[str, Consumer]
) -> None:
    """Write ``checkpoint.pt`` atomically.

    Call it between batches: within one, some consumers have seen what others have not.
    What starts again after a restart are the environments: their episodes begin with
    other scenes, and the views to continue training with are collected again.

    Args:
        folder: the run folder.
        state: counters and tables.
        consumers: of the run's batches, by name.
    """
    checkpoint: dict[str, object] = {
        "kind": _KIND,
        "version": _VERSION,
        "state": {one.name: getattr(state, one.name) for one in fields(state)},
        "consumers": {name: one.state_dict() for name, one in consumers.items()},
        "torch_generator": torch.get_rng_state(),
    }
    save_atomically(checkpoint, folder / CHECKPOINT_FILE)


def save_policy(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``policy.pt``, an explorer's weights, atomically."""
    kept: dict[str, object] = {"kind": "toponav policy", "weights": dict(weights)}
    save_atomically(kept, folder / POLICY_FILE)


def restore_exploration(
    folder: Path, state: ExplorationState, consumers: Mapping[str, Consumer]
) -> None:
    """Read what `save_exploration` wrote into the same objects.

    A run that was cut off before its first checkpoint begins at its start.

    Args:
        folder: the run folder.
        state: gets the counters and tables.
        consumers: get their states.

    Raises:
        SettingsError: if the checkpoint is damaged or of other settings.
    """
    path = folder / CHECKPOINT_FILE
    if not path.is_file():
        return
    found: dict[str, Any] = load_checkpoint(path, "resume")
    if found.get("kind") != _KIND or found.get("version") != _VERSION:
        raise SettingsError(
            f"resume must name an exploration of version {_VERSION}, got {path} with "
            f"{found.get('kind', 'something else')} {found.get('version', '')}".rstrip()
        )
    try:
        for name, consumer in consumers.items():
            # A run that resumes with a part that it had not gets it fresh.
            if name in found["consumers"]:
                consumer.load_state_dict(found["consumers"][name])
        torch.set_rng_state(found["torch_generator"])
        for one in fields(state):
            setattr(state, one.name, found["state"][one.name])
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise SettingsError(
            f"resume must name a run whose checkpoint fits its settings, got {path} "
            f"({str(error).strip().splitlines()[0][:80]})"
        ) from error
