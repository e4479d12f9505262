"""`OnlineLearning`: TC-network and L-network learn on from the explorer's own views."""

import torch
from tensordict import TensorDictBase
from torch.nn.utils import clip_grad_norm_
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from toponav.builders.devices import make_autocast
from toponav.builders.learner import Check
from toponav.builders.networks import Networks
from toponav.builders.training import make_losses, make_pair_source
from toponav.config import ExploreConfig
from toponav.keys import ACTION, PIXELS, TRAJECTORY

_KEPT = (PIXELS, ACTION, TRAJECTORY, "step_count")
# As in pre-training.
_LOCOMOTION_COEFF = 0.5
_MAX_GRAD_NORM = 10.0
_WEIGHT_DECAY = 1e-4


class OnlineLearning:
    """Trains the networks a second time, from what the explorer sees.

    Reference:
        The paper, "Generalization of TC-network and L-network": networks that were
        trained on random walks are trained once more while the agent explores.

    Args:
        config: settings of the run.
        networks: trained in place; in ``train()`` mode during an update alone.
        check: called before every step of the optimiser with the losses and the
            number of the update; raises if one is no number.
    """

    def __init__(
        self, config: ExploreConfig, networks: Networks, *, check: Check
    ) -> None:
        device = next(networks.modules.parameters()).device
        online = config.online
        self.config = online
        self.networks = networks
        self.check = check
        self.updates = 0
        self.generator = torch.Generator().manual_seed(config.seed)
        side = 2 if config.halve else 1
        frame = (120 // side) * (160 // side) * 3
        num_frames = max(int(online.buffer_gb * 1e9) // frame, online.ahead)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(num_frames))
        self.pairs = make_pair_source(
            config.pairs,
            networks,
            self.buffer.storage,
            generator=self.generator,
            device=device,
        )
        self.losses = make_losses(networks, mined=config.pairs.mined)
        self.optimizer = torch.optim.AdamW(
            networks.modules.parameters(), lr=online.lr, weight_decay=_WEIGHT_DECAY
        )
        self.autocast = make_autocast(device, bf16=True)
        self._since_update = self._since_version = 0

    def add(self, batch: TensorDictBase) -> None:
        """Keep the views of a batch."""
        frames = batch.select(*_KEPT).flatten()
        self.buffer.extend(frames)
        self._since_version += len(frames)
        if len(self.buffer) >= self.config.ahead:
            self._since_update += len(frames)

    def learn(self, batch: TensorDictBase) -> tuple[dict[str, float], bool]:
        """Keep the views of a batch and make the updates that are due.

        Args:
            batch: ``[E, T]`` decisions with views, actions and episode numbers.

        Returns:
            Means of both losses, nothing if no update was due; and whether the time
            for a new version has come.
        """
        self.add(batch)
        measured = []
        while self._since_update >= self.config.every:
            self._since_update -= self.config.every
            measured.append(self.update())
        means = {
            name: sum(one[name] for one in measured) / len(measured)
            for name in (measured[0] if measured else ())
        }
        return means, self.is_version_due()

    def is_version_due(self) -> bool:
        """Whether a version should be published; asking counts as doing it."""
        ready = len(self.buffer) >= self.config.ahead
        if not ready or self._since_version < self.config.publish_every:
            return False
        self._since_version = 0
        return True

    def update(self) -> dict[str, float]:
        """Make one update; both losses."""
        networks = self.networks.modules
        networks.train()
        with self.autocast:
            tc_pairs, l_pairs = self.pairs()
            tc_loss, l_loss = self.losses
            tc, locomotion = tc_loss(tc_pairs), l_loss(l_pairs)
        loss = tc["loss_tc"] + _LOCOMOTION_COEFF * locomotion["loss_locomotion"]
        self.optimizer.zero_grad()
        loss.backward()
        clip_grad_norm_(networks.parameters(), _MAX_GRAD_NORM)
        measured = {
            "loss_tc": float(tc["loss_tc"].detach()),
            "loss_locomotion": float(locomotion["loss_locomotion"].detach()),
        }
        self.check(measured, self.updates)
        self.optimizer.step()
        self.updates += 1
        networks.eval()
        return measured

    def state_dict(self) -> dict[str, object]:
        """What another one needs to go on, but the views: those are collected anew."""
        return {
            "weights": self.networks.modules.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, object]) -> None:
        """Go on where `state_dict` was taken."""
        self.networks.modules.load_state_dict(state["weights"])  # type: ignore[arg-type]
        self.optimizer.load_state_dict(state["optimizer"])  # type: ignore[arg-type]
        self.generator.set_state(state["generator"])  # type: ignore[arg-type]
        self.updates = int(state["updates"])  # type: ignore[call-overload]


def make_online_learning(
    config: ExploreConfig, networks: Networks, *, check: Check
) -> OnlineLearning | None:
    """`OnlineLearning` if the settings want it."""
    if not config.online.learn:
        return None
    return OnlineLearning(config, networks, check=check)
