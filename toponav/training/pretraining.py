"""The course of a pre-training: when to collect, how fast to learn, its checkpoint."""

import math
from contextlib import AbstractContextManager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torchrl.data.replay_buffers import Storage

from toponav.builders import Networks, require_same_model
from toponav.config import ModelConfig, PretrainConfig, SettingsError, TrainConfig
from toponav.runs import CHECKPOINT_FILE, load_checkpoint, save_atomically
from toponav.training.pair_trainer import (
    PairTrainer,
    make_pair_trainer,
    require_finite,
)

_KIND, _VERSION = "toponav training", 1


def make_pretrainer(
    config: PretrainConfig,
    networks: Networks,
    storage: Storage,
    *,
    autocast: AbstractContextManager[None],
    folder: Path,
) -> PairTrainer:
    """The trainer of a pre-training; ``folder`` is named if a loss is not finite."""
    train = config.train
    return make_pair_trainer(
        networks,
        config.pairs,
        storage,
        seed=config.seed,
        locomotion_coeff=train.locomotion_coeff,
        lr=partial(learning_rate, train),
        weight_decay=train.weight_decay,
        max_grad_norm=train.max_grad_norm,
        autocast=autocast,
        check=partial(require_finite, folder=folder),
    )


def learning_rate(config: TrainConfig, update: int) -> float:
    """The learning rate of an update: a linear rise, then constant or half a cosine."""
    if update < config.warmup:
        return config.lr * (update + 1) / config.warmup
    if config.schedule == "constant":
        return config.lr
    rest = max(config.updates - config.warmup, 1)
    return config.lr * 0.5 * (1 + math.cos(math.pi * (update - config.warmup) / rest))


def decisions_due(config: PretrainConfig, update: int) -> int:
    """Decisions that must have been collected before an update.

    It depends on counts alone, not on the clock: the same update meets the same frames
    on a fast machine, on a slow one and after a restart.
    """
    collect = config.collect
    done = min(1.0, update / (collect.share * config.train.updates))
    rest = collect.decisions - collect.ahead
    return collect.ahead + round(rest * done)


def save_training(
    folder: Path,
    networks: Networks,
    trainer: PairTrainer,
    history: list[dict[str, float]],
) -> None:
    """Write ``checkpoint.pt``: all but the frames, which are collected again."""
    state: dict[str, object] = {
        "kind": _KIND,
        "version": _VERSION,
        "model": asdict(networks.model),
        **trainer.state_dict(),
        "torch_generator": torch.get_rng_state(),
        "history": history,
    }
    save_atomically(state, folder / CHECKPOINT_FILE)


def restore_training(
    folder: Path, networks: Networks, trainer: PairTrainer
) -> list[dict[str, float]]:
    """Read what `save_training` wrote into the same objects.

    Returns:
        The measurements so far.

    Raises:
        SettingsError: if there is no checkpoint, it is damaged or of another model.
    """
    path = folder / CHECKPOINT_FILE
    state: dict[str, Any] = load_checkpoint(path, "resume")
    if state.get("kind") != _KIND or state.get("version") != _VERSION:
        raise SettingsError(
            f"resume must name a run of version {_VERSION}, got {path} with "
            f"{state.get('kind', 'something else')} {state.get('version', '')}".rstrip()
        )
    try:
        model = ModelConfig(**state["model"])
        require_same_model(model, networks.model, "resume")
        # Earlier runs name the number of updates in the singular.
        trainer.load_state_dict({"updates": state.get("update"), **state})
        torch.set_rng_state(state["torch_generator"])
        return list(state["history"])
    except (KeyError, TypeError, RuntimeError) as error:
        raise SettingsError(
            f"resume must name a run whose checkpoint fits its model, got {path} "
            f"({str(error).strip().splitlines()[0][:80]})"
        ) from error
