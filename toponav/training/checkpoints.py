"""What a run has done so far, and the checkpoints from which it is resumed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from toponav.builders import Consumer, Networks, require_same_model
from toponav.config import ExploreCollectConfig, ModelConfig
from toponav.runs import CHECKPOINT_FILE, reading_checkpoint, save_atomically
from toponav.training.episode_log import Row
from toponav.training.pair_trainer import PairTrainer
from toponav.training.whole_states import require_whole, unlike_counts

_EXPLORATION = {"kind": "toponav exploration", "version": 2}
_TRAINING = {"kind": "toponav training", "version": 1}


@dataclass
class ExplorationState:
    """Counters and tables of a run."""

    decisions: int = 0  # learned from, over all environments
    seconds: float = 0.0  # of exploring; pre-training is not in it
    progress: float = 0.0  # how much of the run is over, in [0, 1]
    versions: dict[str, int] = field(default_factory=dict)  # newest published, by name
    history: list[Row] = field(default_factory=list)  # rows of metrics.csv
    # Since the last row of metrics.csv: what was measured, and the episodes that ended.
    measured: dict[str, list[float]] = field(default_factory=dict)
    ended: list[Row] = field(default_factory=list)

    def count(
        self, decisions: int, seconds: float, collect: ExploreCollectConfig
    ) -> None:
        """Count a batch's decisions; ``seconds`` are the run's so far.

        ``collect`` says when a run is over, by decisions or by the clock.
        """
        self.decisions += decisions
        self.seconds = seconds
        by_clock = seconds / (60 * collect.minutes) if collect.minutes else 0.0
        self.progress = min(1.0, max(self.decisions / collect.decisions, by_clock))


def save_exploration(
    folder: Path,
    state: ExplorationState,
    consumers: Mapping[str, Consumer],
    episodes: Sequence[Mapping[str, Any]] | None = None,
) -> None:
    """Write ``checkpoint.pt`` atomically, between two batches.

    Within one, some consumers have seen what others have not. With ``episodes``, of
    `running_episodes`, a resumed run does what it would have done, to the last digit,
    unless ``online.learn`` or the replay of ``loss=dqn`` or ``drqn`` needs views, which
    are collected again. Without (with ``collect.mode=async`` or ``world=gym``) it
    begins new ones, with other scenes.

    Raises:
        TrainingError: if the states do not fit each other; the former file stays.
    """
    states = {name: one.state_dict() for name, one in consumers.items()}
    require_whole(state.decisions, states)
    checkpoint: dict[str, object] = {
        **_EXPLORATION,
        "state": dict(vars(state)),
        "consumers": states,
        "torch_generator": torch.get_rng_state(),
    }
    if episodes is not None:
        running = {name: one.running_episodes() for name, one in consumers.items()}
        checkpoint["episodes"] = {"collectors": episodes, "consumers": running}
    save_atomically(checkpoint, folder / CHECKPOINT_FILE)


def restore_exploration(
    folder: Path, state: ExplorationState, consumers: Mapping[str, Consumer]
) -> list[dict[str, Any]] | None:
    """Read what `save_exploration` wrote into the same objects; returns ``episodes``.

    A run that was cut off before its first checkpoint begins at its start.

    Raises:
        SettingsError: if the checkpoint is damaged or of other settings, or its parts
            do not fit each other.
    """
    path = folder / CHECKPOINT_FILE
    if not path.is_file():
        return None
    with reading_checkpoint(path, "resume", _EXPLORATION, "an exploration") as found:
        # Before anything is changed: some of it is used much later, or elsewhere.
        _require_state(found["state"])
        known = consumers.keys() & found["consumers"].keys()
        states = {name: found["consumers"][name] for name in known}
        if (unlike := unlike_counts(found["state"]["decisions"], states)) is not None:
            raise ValueError(f"it must have {unlike}")
        for name, consumer in consumers.items():
            # A consumer that is new in the resumed run starts fresh.
            if name in found["consumers"]:
                consumer.load_state_dict(found["consumers"][name])
        torch.set_rng_state(found["torch_generator"])
        # Earlier runs have fewer entries.
        for name, value in found["state"].items():
            setattr(state, name, value)
        if (running := found.get("episodes")) is None:
            return None
        for name, episodes in running["consumers"].items():
            consumers[name].resume_episodes(episodes)
    collectors: list[dict[str, Any]] = running["collectors"]
    return collectors


def save_training(
    folder: Path,
    networks: Networks,
    trainer: PairTrainer,
    history: list[dict[str, float]],
) -> None:
    """Write ``checkpoint.pt``: all but the frames, which are collected again."""
    checkpoint: dict[str, object] = {
        **_TRAINING,
        "model": asdict(networks.model),
        **trainer.state_dict(),
        "torch_generator": torch.get_rng_state(),
        "history": history,
    }
    save_atomically(checkpoint, folder / CHECKPOINT_FILE)


def restore_training(
    folder: Path, networks: Networks, trainer: PairTrainer
) -> list[dict[str, float]]:
    """Read what `save_training` wrote into the same objects; returns the measurements.

    Raises:
        SettingsError: if there is no checkpoint, it is damaged or of another model.
    """
    path = folder / CHECKPOINT_FILE
    with reading_checkpoint(path, "resume", _TRAINING, "a run") as found:
        require_same_model(ModelConfig(**found["model"]), networks.model, "resume")
        # Earlier runs name the number of updates in the singular.
        trainer.load_state_dict({"updates": found.get("update"), **found})
        torch.set_rng_state(found["torch_generator"])
        history: list[dict[str, float]] = found["history"]
    return history


def _require_state(state: Mapping[str, Any]) -> None:
    """Raise ValueError unless counters and tables are of the kinds that runs write."""
    for name, like in vars(ExplorationState()).items():
        found = state.get(name, like)
        fits = type(found) is type(like)
        if isinstance(found, int | float):
            fits = fits and 0 <= found < math.inf
        if not fits:
            rule = f"{name} must be of type {type(like).__name__}, and not negative"
            raise ValueError(f"{rule}, got {str(found)[:30]}")
