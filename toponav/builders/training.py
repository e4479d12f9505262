"""What a training loop needs: pairs, losses, the optimizer, its state on disk."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data.replay_buffers import Storage

from toponav.builders.checkpoints import load_checkpoint, save_atomically
from toponav.builders.networks import Networks, require_same_model
from toponav.config import (
    ModelConfig,
    PairsConfig,
    PretrainConfig,
    SettingsError,
    TrainConfig,
    TrainingError,
)
from toponav.data import Chunks, DrawnPairs, LPairs, MinedPairs, TCPairs
from toponav.keys import ANCHOR, LOGIT, LOGITS, OTHER
from toponav.objectives import LLoss, TCLoss

#: The file in a run folder from which training goes on.
CHECKPOINT_FILE = "checkpoint.pt"
_VERSION = 1


def make_pair_source(
    pairs: PairsConfig,
    networks: Networks,
    storage: Storage,
    *,
    generator: torch.Generator,
    device: torch.device | str = "cpu",
) -> MinedPairs | DrawnPairs:
    """Where training pairs come from: call it for the pairs of one update.

    Mined pairs are of embeddings, drawn ones of views; `make_losses` fits.

    Args:
        pairs: which pairs.
        networks: embed the views, if pairs are mined.
        storage: of the frames.
        generator: source of the random numbers; on the CPU.
        device: of the networks.
    """
    tc_pairs = TCPairs(pairs.k, pairs.m, other_episode_share=pairs.other_episode_share)
    l_pairs = LPairs(pairs.locomotion_k)
    if not pairs.mined:
        return DrawnPairs(
            storage,
            pairs.per_update,
            tc_pairs=tc_pairs,
            l_pairs=l_pairs,
            generator=generator,
            device=device,
        )
    shared = networks.model.share_encoder
    return MinedPairs(
        storage,
        Chunks(pairs.chunks, pairs.chunk_len, min_length=tc_pairs.min_distance + 1),
        pairs.episodes * pairs.chunks * pairs.chunk_len,
        tc_pairs=tc_pairs,
        l_pairs=l_pairs,
        embed_tc=networks.tc.encoder,
        embed_l=None if shared else networks.locomotion.encoder,
        max_pairs=pairs.per_update,
        generator=generator,
        device=device,
    )


def make_losses(networks: Networks, *, mined: bool) -> tuple[TCLoss, LLoss]:
    """Losses of pairs of embeddings (mined) or of views (drawn)."""
    compare: nn.Module = networks.tc.comparator if mined else networks.tc  # type: ignore[assignment]
    act: nn.Module = networks.locomotion.head if mined else networks.locomotion
    pair = [ANCHOR, OTHER]
    return (
        TCLoss(TensorDictModule(compare, in_keys=pair, out_keys=[LOGIT])),
        LLoss(TensorDictModule(act, in_keys=pair, out_keys=[LOGITS])),
    )


def make_optimizer(networks: Networks, config: TrainConfig) -> torch.optim.AdamW:
    """Adam with decoupled weight decay over both networks."""
    return torch.optim.AdamW(
        networks.modules.parameters(), lr=config.lr, weight_decay=config.weight_decay
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

    A matter of counts alone, not of the clock: the same update meets the same frames
    on a fast machine, on a slow one and after a restart.
    """
    collect = config.collect
    done = min(1.0, update / (collect.share * config.train.updates))
    rest = collect.decisions - collect.ahead
    return collect.ahead + round(rest * done)


def require_finite(
    figures: Mapping[str, float],
    update: int,
    folder: Path,
    *,
    setting: str = "train.lr",
) -> None:
    """Stop a training whose losses are no numbers any more.

    Args:
        figures: losses by name.
        update: number of the update, for the message.
        folder: the run folder, for the message.
        setting: the learning rate's, for the message.

    Raises:
        TrainingError: names the first figure that is not finite.
    """
    for name, figure in figures.items():
        if not math.isfinite(figure):
            raise TrainingError(
                f"{name} must be finite, got {figure:g} in update {update}; the last "
                f"good state is {folder / CHECKPOINT_FILE}, "
                f"a smaller {setting} may help"
            )


def save_training(
    folder: Path,
    networks: Networks,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
    *,
    update: int,
    history: list[dict[str, float]],
) -> None:
    """Write all that a run needs to go on, but the frames: those are walked anew.

    Args:
        folder: the run folder.
        networks: the networks.
        optimizer: their optimizer.
        generator: of the pairs.
        update: number of updates done.
        history: measurements so far.
    """
    state: dict[str, object] = {
        "kind": "toponav training",
        "version": _VERSION,
        "model": asdict(networks.model),
        "weights": networks.modules.state_dict(),
        "optimizer": optimizer.state_dict(),
        "generator": generator.get_state(),
        "torch_generator": torch.get_rng_state(),
        "update": update,
        "history": history,
    }
    save_atomically(state, folder / CHECKPOINT_FILE)


def restore_training(
    folder: Path,
    networks: Networks,
    optimizer: torch.optim.Optimizer,
    generator: torch.Generator,
) -> tuple[int, list[dict[str, float]]]:
    """Read what `save_training` wrote into the same objects.

    Args:
        folder: the run folder.
        networks: get the weights.
        optimizer: gets its state.
        generator: gets its state.

    Returns:
        The number of updates done, and the measurements so far.

    Raises:
        SettingsError: if there is no checkpoint, it is damaged or of another model.
    """
    path = folder / CHECKPOINT_FILE
    state = load_checkpoint(path, "resume")
    if state.get("kind") != "toponav training" or state.get("version") != _VERSION:
        raise SettingsError(
            f"resume must name a run of version {_VERSION}, got {path} with "
            f"{state.get('kind', 'something else')} {state.get('version', '')}".rstrip()
        )
    try:
        model = ModelConfig(**state["model"])  # type: ignore[arg-type]
        require_same_model(model, networks.model, "resume")
        networks.modules.load_state_dict(state["weights"])  # type: ignore[arg-type]
        optimizer.load_state_dict(state["optimizer"])  # type: ignore[arg-type]
        generator.set_state(state["generator"])  # type: ignore[arg-type]
        torch.set_rng_state(state["torch_generator"])  # type: ignore[arg-type]
        return int(state["update"]), list(state["history"])  # type: ignore[call-overload]
    except (KeyError, TypeError, RuntimeError) as error:
        raise SettingsError(
            f"resume must name a run whose checkpoint fits its model, got {path} "
            f"({str(error).strip().splitlines()[0][:80]})"
        ) from error
