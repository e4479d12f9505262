"""`ContinuedTraining`: train both networks further on the explorer's views."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from toponav.builders import (
    NETWORKS,
    Check,
    Consumer,
    Networks,
    frames_that_fit,
    make_autocast,
)
from toponav.config import OnlineConfig, PairsConfig
from toponav.keys import ACTION, NETWORK_PIXELS, TRAJECTORY
from toponav.training.pair_trainer import make_pair_trainer

_MAX_GRAD_NORM = 10.0


class ContinuedTraining(Consumer):
    """Takes the batches of an exploration, and trains the networks from their views.

    Reference:
        The paper, "Generalization of TC-network and L-network": networks that were
        trained on random walks are trained once more while the agent explores.

    Args:
        config: when and how fast to learn.
        pairs: which pairs of views.
        networks: trained in place; in ``train()`` mode during an update only.
        seed: of the pairs.
        weight_decay: of AdamW.
        locomotion_coeff: weight of the L-network's loss beside the TC-network's.
        check: see `PairTrainer`.
    """

    in_keys: Sequence[NestedKey] = (NETWORK_PIXELS, ACTION, TRAJECTORY, "step_count")

    def __init__(
        self,
        config: OnlineConfig,
        pairs: PairsConfig,
        networks: Networks,
        *,
        seed: int,
        weight_decay: float,
        locomotion_coeff: float,
        check: Check,
    ) -> None:
        self.config = config
        num_frames = frames_that_fit(
            config.buffer_gb, networks.view_size, halve=networks.halve
        )
        storage = LazyTensorStorage(max(num_frames, config.ahead))
        self.buffer = TensorDictReplayBuffer(storage=storage)
        self.trainer = make_pair_trainer(
            networks,
            pairs,
            storage,
            seed=seed,
            locomotion_coeff=locomotion_coeff,
            lr=config.lr,
            weight_decay=weight_decay,
            max_grad_norm=_MAX_GRAD_NORM,
            autocast=make_autocast(networks.device, bf16=True),
            check=check,
        )
        self._since_update = self._since_version = 0

    def extend(self, batch: TensorDictBase) -> dict[str, float]:
        """Keep the views of a batch ``[E, T]`` and make the updates that are due.

        Returns:
            Means of both losses, nothing if no update was due.
        """
        frames = batch.select(*self.in_keys).flatten()
        self.buffer.extend(frames)
        self._since_version += len(frames)
        if len(self.buffer) >= self.config.ahead:
            self._since_update += len(frames)
        measured = []
        while self._since_update >= self.config.every:
            self._since_update -= self.config.every
            measured.append(self.trainer.step())
        return {
            name: sum(one[name] for one in measured) / len(measured)
            for name in ("loss_tc", "loss_locomotion")
            if measured
        }

    def updated(self) -> Collection[str]:
        """The networks, if the time for a new version has come; asking counts."""
        ready = len(self.buffer) >= self.config.ahead
        if not ready or self._since_version < self.config.publish_every:
            return ()
        self._since_version = 0
        return (NETWORKS,)

    def state_dict(self) -> dict[str, Any]:
        """What another one needs to continue; views are collected again."""
        return self.trainer.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.trainer.load_state_dict(state)
