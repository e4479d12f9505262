"""`ContinuedTraining`: train both networks further on the explorer's views."""

from collections.abc import Collection, Mapping
from typing import Any

from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from toponav.builders import (
    FRAME_KEYS,
    NETWORKS,
    Check,
    Consumer,
    Networks,
    frames_that_fit,
    make_autocast,
)
from toponav.config import ExploreConfig
from toponav.training.episode_log import mean_of
from toponav.training.pair_trainer import make_pair_trainer


class ContinuedTraining(Consumer):
    """Takes the batches of an exploration, and trains the networks from their views.

    Reference:
        The paper, "Generalization of TC-network and L-network": networks that were
        trained on random walks are trained once more while the agent explores.

    Args:
        settings: ``online`` says when and how fast to learn, ``pairs`` from what.
        networks: trained in place; in ``train()`` mode during an update only.
        check: see `PairTrainer`.
    """

    in_keys = FRAME_KEYS

    def __init__(
        self, settings: ExploreConfig, networks: Networks, check: Check
    ) -> None:
        self.config = config = settings.online
        num_frames = frames_that_fit(
            config.buffer_gb, networks.view_size, halve=networks.model.halve
        )
        storage = LazyTensorStorage(max(num_frames, config.ahead))
        self.buffer = TensorDictReplayBuffer(storage=storage)
        self.trainer = make_pair_trainer(
            networks,
            settings.pairs,
            config,
            storage,
            seed=settings.seed,
            lr=config.lr,
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
        names = ("loss_tc", "loss_locomotion") if measured else ()
        return {name: mean_of(measured, name) for name in names}

    def updated(self) -> Collection[str]:
        """The networks, if the time for a new version has come; asking counts."""
        ready = len(self.buffer) >= self.config.ahead
        if not ready or self._since_version < self.config.publish_every:
            return ()
        self._since_version = 0
        return (NETWORKS,)

    def state_dict(self) -> dict[str, Any]:
        """That of the trainer; views are collected again."""
        return self.trainer.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.trainer.load_state_dict(state)
