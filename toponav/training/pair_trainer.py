"""`PairTrainer`: updates of the TC-network and the L-network from pairs of views."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.data.replay_buffers import Storage
from torchrl.objectives import LossModule

from toponav.builders import Check, Networks
from toponav.config import PairsConfig, TrainingError
from toponav.data import Chunks, DrawnPairs, LPairs, MinedPairs, TCPairs
from toponav.keys import ANCHOR, LOGIT, LOGITS, OTHER
from toponav.objectives import LLoss, TCLoss
from toponav.runs import CHECKPOINT_FILE

#: Called with measurements and the number of the update; raises to stop the training.


class PairTrainer:
    """Trains networks with AdamW; the networks are in ``train()`` mode in a step only.

    Args:
        network: holds the parameters that are trained.
        losses: by a short name, each with its coefficient in the sum.
        draw_pairs: draws the pairs of one update, an entry for each loss, in order.
        generator: of the random numbers of ``draw_pairs``; part of the state.
        lr: learning rate, or the learning rate after so many updates.
        weight_decay: decoupled weight decay.
        max_grad_norm: largest norm of the gradient; a longer one is scaled down.
        autocast: the precision of embeddings and losses.
        check: called before the parameters change.

    Examples:
        >>> from tensordict import TensorDict
        >>> from toponav.modules import LocomotionHead
        >>> head = LocomotionHead(8, hidden=(16,), num_actions=4)
        >>> trainer = PairTrainer(
        ...     head,
        ...     {"l": (make_l_loss(head), 1.0)},
        ...     lambda: [TensorDict(anchor=torch.zeros(6, 8), other=torch.ones(6, 8),
        ...         action=torch.zeros(6, dtype=torch.int64), batch_size=[6])],
        ...     generator=torch.Generator(),
        ...     lr=1e-2,
        ...     weight_decay=0.0,
        ...     max_grad_norm=1.0,
        ... )
        >>> sorted(trainer.step())
        ['gradient_norm', 'loss_locomotion', 'train_l_accuracy']
    """

    def __init__(
        self,
        network: nn.Module,
        losses: Mapping[str, tuple[LossModule, float]],
        draw_pairs: Callable[[], Sequence[TensorDictBase]],
        *,
        generator: torch.Generator,
        lr: float | Callable[[int], float],
        weight_decay: float,
        max_grad_norm: float,
        autocast: AbstractContextManager[None] | None = None,
        check: Check | None = None,
    ) -> None:
        self.network = network
        self.losses = losses
        self.draw_pairs = draw_pairs
        self.generator = generator
        self.lr = lr
        self.max_grad_norm = max_grad_norm
        self.autocast = nullcontext() if autocast is None else autocast
        self.check = check
        self.optimizer = torch.optim.AdamW(
            network.parameters(),
            lr=lr(0) if callable(lr) else lr,
            weight_decay=weight_decay,
        )
        self.updates = 0
        network.eval()

    def step(self) -> dict[str, float]:
        """Make one update.

        Returns:
            Each loss, each loss's ``train_<name>_accuracy``, and ``gradient_norm``
            before it was scaled down.
        """
        if callable(self.lr):
            for group in self.optimizer.param_groups:
                group["lr"] = self.lr(self.updates)
        self.network.train()
        losses, accuracies = dict[str, Tensor](), dict[str, Tensor]()
        total = torch.zeros(())
        with self.autocast:
            batches = self.draw_pairs()
            for (name, (loss, coeff)), pairs in zip(
                self.losses.items(), batches, strict=True
            ):
                loss_key, accuracy_key = loss.out_keys
                result = loss(pairs)
                total = total + coeff * result[loss_key]
                losses[loss_key] = result[loss_key]
                accuracies[f"train_{name}_accuracy"] = result[accuracy_key]
        self.optimizer.zero_grad()
        total.backward()
        norm = clip_grad_norm_(self.network.parameters(), self.max_grad_norm)
        found = losses | accuracies | {"gradient_norm": norm}
        measured = {name: float(value.detach()) for name, value in found.items()}
        self.updates += 1
        if self.check is not None:
            self.check(measured, self.updates)
        self.optimizer.step()
        self.network.eval()
        return measured

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimiser, random numbers and number of updates."""
        return {
            "weights": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.network.load_state_dict(state["weights"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"])
        self.updates = int(state["updates"])


def make_pair_trainer(
    networks: Networks,
    pairs: PairsConfig,
    storage: Storage,
    *,
    seed: int,
    locomotion_coeff: float,
    lr: float | Callable[[int], float],
    weight_decay: float,
    max_grad_norm: float,
    autocast: AbstractContextManager[None],
    check: Check,
) -> PairTrainer:
    """A `PairTrainer` of both networks, from the frames in a storage.

    ``seed`` is of the pairs; ``locomotion_coeff`` is the weight of the L-network's loss
    beside the TC-network's.
    """
    generator = torch.Generator().manual_seed(seed)
    mined = pairs.mined
    tc: nn.Module = networks.tc.comparator if mined else networks.tc  # type: ignore[assignment]
    locomotion = networks.locomotion.head if mined else networks.locomotion
    return PairTrainer(
        networks.modules,
        {
            "tc": (make_tc_loss(tc), 1.0),
            "l": (make_l_loss(locomotion), locomotion_coeff),
        },
        make_pair_source(networks, pairs, storage, generator),
        generator=generator,
        lr=lr,
        weight_decay=weight_decay,
        max_grad_norm=max_grad_norm,
        autocast=autocast,
        check=check,
    )


def make_tc_loss(network: nn.Module) -> TCLoss:
    """The loss of a TC-network on views, or of its comparator on embeddings."""
    return TCLoss(TensorDictModule(network, [ANCHOR, OTHER], [LOGIT]))


def make_l_loss(network: nn.Module) -> LLoss:
    """The loss of an L-network on views, or of its head on embeddings."""
    return LLoss(TensorDictModule(network, [ANCHOR, OTHER], [LOGITS]))


def make_pair_source(
    networks: Networks,
    pairs: PairsConfig,
    storage: Storage,
    generator: torch.Generator,
) -> MinedPairs | DrawnPairs:
    """Draws the pairs of one update: of embeddings if they are mined, else of views."""
    tc_pairs = TCPairs(pairs.k, pairs.m, other_episode_share=pairs.other_episode_share)
    l_pairs = LPairs(pairs.locomotion_k)
    if not pairs.mined:
        return DrawnPairs(
            storage,
            pairs.per_update,
            tc_pairs=tc_pairs,
            l_pairs=l_pairs,
            generator=generator,
            device=networks.device,
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
        device=networks.device,
    )


def require_finite(
    figures: Mapping[str, float],
    update: int,
    folder: Path,
    *,
    setting: str = "train.lr",
) -> None:
    """Stop a training whose measurements are not finite; fits as a `Check`.

    The message names the run folder and the setting of the learning rate.

    Raises:
        TrainingError: names the measurement.
    """
    for name, figure in figures.items():
        if not math.isfinite(figure):
            raise TrainingError(
                f"{name} must be finite, got {figure:g} in update {update}; the last "
                f"good state is {folder / CHECKPOINT_FILE}, "
                f"a smaller {setting} may help"
            )
