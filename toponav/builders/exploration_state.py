"""`ExplorationState`: what a run of exploration has done so far, and its checkpoint."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from toponav.builders.checkpoints import load_checkpoint, save_atomically
from toponav.builders.episode_log import Row, mean_of
from toponav.builders.learner import Learner
from toponav.builders.map_growth import MapGrowth, NoMap
from toponav.builders.online import OnlineLearning
from toponav.builders.training import CHECKPOINT_FILE
from toponav.builders.walks import NoWalks, Walks
from toponav.config import ExploreCollectConfig, SettingsError

#: The file in a run folder that holds the best policy.
POLICY_FILE = "policy.pt"
_KIND, _VERSION = "toponav exploration", 1


@dataclass
class ExplorationState:
    """Counters, tables and the best policy of a run.

    Args:
        decisions: learned from, over all environments.
        seconds: of exploring; pre-training is not in it.
        policy_version: the newest that was published.
        networks_version: of the TC-network and the L-network.
        history: rows of ``metrics.csv``.
        episodes: rows of ``episodes.csv``.
        evaluations: rows of ``evaluation.csv``.
        best_return: highest mean return so far, over the last episodes.
        best_version: of the networks by which that return was reckoned.
        best_decisions: when it was reached.
        best_policy: weights that reached it, ``None`` before the first.
    """

    decisions: int = 0
    seconds: float = 0.0
    policy_version: int = 0
    networks_version: int = 0
    history: list[Row] = field(default_factory=list)
    episodes: list[Row] = field(default_factory=list)
    evaluations: list[Row] = field(default_factory=list)
    best_return: float = -math.inf
    best_version: int = 0
    best_decisions: int = 0
    best_policy: dict[str, Tensor] | None = None

    def progress(self, collect: ExploreCollectConfig) -> float:
        """How much of the run is over, by decisions or by the clock, in [0, 1]."""
        by_clock = self.seconds / (60 * collect.minutes) if collect.minutes else 0.0
        return min(1.0, max(self.decisions / collect.decisions, by_clock))

    @property
    def levels(self) -> dict[str, float]:
        """Mean coverage of the walks that see nothing, by name."""
        names = [str(row["policy"]) for row in self.evaluations]
        return {
            name: mean_of(
                [row for row in self.evaluations if str(row["policy"]) == name],
                "coverage",
            )
            for name in dict.fromkeys(names)
            if name in ("random", "sticky")
        }

    def consider(self, policy: nn.Module, name: str, window: int) -> bool:
        """Keep the policy if the last episodes paid best.

        Returns of different versions of the networks do not compare: a new version
        starts anew.

        Args:
            policy: as it is now.
            name: the return that counts, a column of ``episodes``.
            window: episodes to take the mean of; fewer are not enough.

        Returns:
            Whether it is the best so far.
        """
        version = self.networks_version
        last = [row for row in self.episodes if row["networks_version"] == version]
        if len(last) < window:
            return False
        mean = mean_of(last[-window:], name)
        if version == self.best_version and mean <= self.best_return:
            return False
        self.best_return, self.best_version = mean, version
        self.best_decisions = self.decisions
        weights = policy.state_dict().items()
        self.best_policy = {name: value.cpu().clone() for name, value in weights}
        return True


def save_exploration(
    folder: Path,
    state: ExplorationState,
    learner: Learner,
    online: OnlineLearning | None,
    grown: MapGrowth | NoMap,
    walks: Walks | NoWalks,
) -> None:
    """Write ``checkpoint.pt`` and ``policy.pt``, each whole or not at all.

    All that the learner does next follows from the checkpoint. What starts anew after
    a restart are the environments: their episodes begin with other scenes, and with
    networks that learn on, the store of views fills up again.

    Args:
        folder: the run folder.
        state: counters and tables.
        learner: of the policy.
        online: of the networks, if they learn on.
        grown: the map.
        walks: what the L-network's head is to learn from.
    """
    checkpoint: dict[str, object] = {
        "kind": _KIND,
        "version": _VERSION,
        "state": {one.name: getattr(state, one.name) for one in fields(state)},
        "learner": learner.state_dict(),
        "online": None if online is None else online.state_dict(),
        "map": grown.state_dict(),
        "walks": walks.state_dict(),
        "torch_generator": torch.get_rng_state(),
    }
    save_atomically(checkpoint, folder / CHECKPOINT_FILE)
    save_policy(folder, state.best_policy or learner.policy.state_dict())


def save_policy(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``policy.pt``, whole or not at all: an explorer's weights."""
    kept: dict[str, object] = {"kind": "toponav policy", "weights": dict(weights)}
    save_atomically(kept, folder / POLICY_FILE)


def start_exploration(
    folder: Path,
    learner: Learner,
    online: OnlineLearning | None,
    grown: MapGrowth | NoMap,
    walks: Walks | NoWalks,
    *,
    resume: bool,
) -> ExplorationState:
    """A fresh run, or what `save_exploration` wrote, read into the same objects.

    Args:
        folder: the run folder.
        learner: gets weights, optimiser and the scale of rewards.
        online: gets the networks' weights and optimiser.
        grown: gets the map.
        walks: gets what was kept.
        resume: whether to go on; a run that was cut off before its first checkpoint
            begins at its start.

    Raises:
        SettingsError: if the checkpoint is damaged or of other settings.
    """
    path = folder / CHECKPOINT_FILE
    if not (resume and path.is_file()):
        return ExplorationState()
    found: dict[str, Any] = load_checkpoint(path, "resume")
    if found.get("kind") != _KIND or found.get("version") != _VERSION:
        raise SettingsError(
            f"resume must name an exploration of version {_VERSION}, got {path} with "
            f"{found.get('kind', 'something else')} {found.get('version', '')}".rstrip()
        )
    try:
        learner.load_state_dict(found["learner"])
        if online is not None and found["online"] is not None:
            online.load_state_dict(found["online"])
        # A run of before maps goes on with an empty one.
        if found.get("map") is not None:
            grown.load_state_dict(found["map"])
        if found.get("walks") is not None:
            walks.load_state_dict(found["walks"])
        torch.set_rng_state(found["torch_generator"])
        return ExplorationState(**found["state"])
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise SettingsError(
            f"resume must name a run whose checkpoint fits its settings, got {path} "
            f"({str(error).strip().splitlines()[0][:80]})"
        ) from error
