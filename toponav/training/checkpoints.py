"""Checkpoints, from which a run is resumed."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from toponav.builders import Consumer, Networks, require_same_model
from toponav.config import ModelConfig, SettingsError
from toponav.runs import CHECKPOINT_FILE, load_checkpoint, save_atomically
from toponav.training.exploration_state import ExplorationState
from toponav.training.pair_trainer import PairTrainer

_EXPLORATION = {"kind": "toponav exploration", "version": 2}
_TRAINING = {"kind": "toponav training", "version": 1}


def save_exploration(
    folder: Path, state: ExplorationState, consumers: Mapping[str, Consumer]
) -> None:
    """Write ``checkpoint.pt`` atomically, between two batches.

    Within one, some consumers have seen what others have not. After a restart,
    episodes begin with other scenes, and the views to continue training with are
    collected again.
    """
    checkpoint: dict[str, object] = {
        **_EXPLORATION,
        "state": dict(vars(state)),
        "consumers": {name: one.state_dict() for name, one in consumers.items()},
        "torch_generator": torch.get_rng_state(),
    }
    save_atomically(checkpoint, folder / CHECKPOINT_FILE)


def restore_exploration(
    folder: Path, state: ExplorationState, consumers: Mapping[str, Consumer]
) -> None:
    """Read what `save_exploration` wrote into the same objects.

    A run that was cut off before its first checkpoint begins at its start.

    Raises:
        SettingsError: if the checkpoint is damaged or of other settings.
    """
    if not (folder / CHECKPOINT_FILE).is_file():
        return
    with _checkpoint_of(folder, _EXPLORATION, "an exploration") as found:
        for name, consumer in consumers.items():
            # A run that resumes with a part that it had not gets it fresh.
            if name in found["consumers"]:
                consumer.load_state_dict(found["consumers"][name])
        torch.set_rng_state(found["torch_generator"])
        for name in vars(state):
            setattr(state, name, found["state"][name])


def save_policy(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``policy.pt``, an explorer's weights, atomically."""
    kept: dict[str, object] = {"kind": "toponav policy", "weights": dict(weights)}
    save_atomically(kept, folder / "policy.pt")


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
    with _checkpoint_of(folder, _TRAINING, "a run") as found:
        require_same_model(ModelConfig(**found["model"]), networks.model, "resume")
        # Earlier runs name the number of updates in the singular.
        trainer.load_state_dict({"updates": found.get("update"), **found})
        torch.set_rng_state(found["torch_generator"])
        history: list[dict[str, float]] = found["history"]
    return history


@contextmanager
def _checkpoint_of(
    folder: Path, wanted: Mapping[str, object], noun: str
) -> Iterator[dict[str, Any]]:
    """The checkpoint of a run folder; refuses one that does not fit when it is read."""
    path = folder / CHECKPOINT_FILE
    found = load_checkpoint(path, "resume")
    if any(found.get(name) != value for name, value in wanted.items()):
        raise SettingsError(
            f"resume must name {noun} of version {wanted['version']}, got {path} with "
            f"{found.get('kind', 'something else')} {found.get('version', '')}".rstrip()
        )
    try:
        yield found
    except SettingsError:
        raise
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise SettingsError(
            f"resume must name a run whose checkpoint fits its settings, got {path} "
            f"({str(error).strip().splitlines()[0][:80]})"
        ) from error
