"""`PairTrainer`: updates of the TC-network and the L-network from pairs of views."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.data.replay_buffers import Storage
from torchrl.objectives import LossModule

from toponav.builders import Check, Networks
from toponav.config import OnlineConfig, PairsConfig, TrainConfig, TrainingError
from toponav.data import Chunks, DrawnPairs, LPairs, MinedPairs, TCPairs
from toponav.objectives import LLoss, TCLoss
from toponav.runs import CHECKPOINT_FILE


class PairTrainer:
    """Trains networks with AdamW; the networks are in ``train()`` mode in a step only.

    Args:
        network: holds the parameters that are trained.
        losses: by a short name, each with its coefficient in the sum.
        draw_pairs: draws the pairs of one update, an entry for each loss, in order.
        generator: of the random numbers of ``draw_pairs``; part of the state.
        lr: learning rate, or the learning rate after so many updates.
        weight_decay, max_grad_norm: of AdamW, and of the gradient at most.
        autocast: the precision of embeddings and losses.
        check: called before the parameters change.

    Examples:
        >>> from tensordict import TensorDict
        >>> from toponav.modules import LocomotionHead
        >>> head = LocomotionHead(8, hidden=(16,), num_actions=4)
        >>> trainer = PairTrainer(
        ...     head,
        ...     {"l": (LLoss(head), 1.0)},
        ...     lambda: [TensorDict(anchor=torch.zeros(6, 8), other=torch.ones(6, 8),
        ...         action=torch.zeros(6, dtype=torch.int64), batch_size=[6])],
        ...     generator=torch.Generator(),
        ...     lr=1e-2,
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
        weight_decay: float = 0.0,
        max_grad_norm: float = 10.0,
        autocast: AbstractContextManager[None] | None = None,
        check: Check | None = None,
    ) -> None:
        self.network = network
        self.losses = losses
        self.draw_pairs = draw_pairs
        self.generator = generator
        self.lr = lr
        self.max_grad_norm = max_grad_norm
        self.autocast = autocast or nullcontext()
        self.check = check
        self.optimizer = torch.optim.AdamW(
            network.parameters(),
            lr=lr(0) if callable(lr) else lr,
            weight_decay=weight_decay,
            fused=True,
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
            drawn = zip(self.losses.items(), self.draw_pairs(), strict=True)
            for (name, (loss, coeff)), pairs in drawn:
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
    config: TrainConfig | OnlineConfig,
    storage: Storage,
    *,
    seed: int,
    **arguments: Any,
) -> PairTrainer:
    """A `PairTrainer` of both networks as one, from the frames in a storage.

    The pairs are of embeddings if they are mined, else of views. ``config`` gives the
    weight of the L-network's loss beside the other, ``arguments`` are `PairTrainer`'s.
    """
    tc, locomotion = networks.tc, networks.locomotion
    generator = torch.Generator().manual_seed(seed)
    rule = TCPairs(pairs.k, pairs.m, other_episode_share=pairs.other_episode_share)
    drawing: dict[str, Any] = {
        "tc_pairs": rule,
        "l_pairs": LPairs(pairs.locomotion_k, pairs.locomotion_exact),
        "generator": generator,
        "device": networks.device,
    }
    if pairs.mined:
        is_shared = locomotion.encoder is tc.encoder
        draw_pairs: MinedPairs | DrawnPairs = MinedPairs(
            storage,
            Chunks(pairs.chunks, pairs.chunk_len, min_length=rule.min_distance + 1),
            pairs.episodes * pairs.chunks * pairs.chunk_len,
            embed_tc=tc.encoder,
            embed_l=None if is_shared else locomotion.encoder,
            max_pairs=pairs.per_update,
            **drawing,
        )
        trained: tuple[nn.Module, nn.Module] = tc.comparator, locomotion.head  # type: ignore[assignment]
    else:
        draw_pairs = DrawnPairs(storage, pairs.per_update, **drawing)
        trained = tc, locomotion
    return PairTrainer(
        networks.modules,
        {
            "tc": (TCLoss(trained[0]), 1.0),
            "l": (LLoss(trained[1]), config.locomotion_coeff),
        },
        draw_pairs,
        generator=generator,
        weight_decay=config.weight_decay,
        **arguments,
    )


def require_finite(
    figures: Mapping[str, float], update: int, folder: Path, *, setting: str
) -> None:
    """Stop a training whose measurements are not finite; fits as a `Check`.

    Raises:
        TrainingError: names the measurement, the run folder and the learning rate.
    """
    for name, figure in figures.items():
        if not math.isfinite(figure):
            raise TrainingError(
                f"{name} must be finite, got {figure:g} in update {update}; the last "
                f"good state is {folder / CHECKPOINT_FILE}, a smaller {setting} may "
                "help"
            )
