"""`QLearner`: what DQN and DRQN have in common."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.data import Categorical
from torchrl.modules import ConvNet, EGreedyModule, QValueModule
from torchrl.objectives import DQNLoss, HardUpdate

from toponav import keys
from toponav.builders import Learner, World
from toponav.config import (
    ExploreConfig,
    LearnerConfig,
    above,
    at_least,
    between,
    require,
)
from toponav.data import SliceReplay
from toponav.methods.learners.actor_critic import linear_decay
from toponav.modules import StatePrimer
from toponav.views import ChannelOrder, channels_last, check_order

# Channels, widths and strides of the convolutions.
_CHANNELS, _WIDTHS, _STRIDES = (32, 64, 64), (8, 4, 3), (4, 2, 1)


@dataclass
class QConfig(LearnerConfig):
    """Settings that DQN and DRQN share."""

    eps: float = above(0)
    gamma: float = between(0, 1)
    reward_scale: float = above(0)
    replay: int = at_least(1)
    warmup: int = at_least(0)
    every: int = at_least(1)
    batch: int = at_least(1)
    target_every: int = at_least(1)
    epsilon: float = between(0, 1)
    epsilon_until: float = between(0, 1)
    test_epsilon: float = between(0, 1)

    @property
    def slice_length(self) -> int:
        """Decisions of a slice from the replay."""
        raise NotImplementedError

    def check_slices(self, name: str) -> None:
        """Refuse slices that are longer than a row of a batch."""
        rule = f"loss.rollout must be at least loss.{name}={self.slice_length}"
        require(self.rollout >= self.slice_length, rule, self.rollout)

    def check(self, num_envs: int) -> None:
        """Refuse a replay that has no room for a batch, or for what it waits for."""
        batch = num_envs * self.rollout
        rule = f"loss.replay must be at least collect.envs * loss.rollout = {batch}"
        require(self.replay >= batch, rule, self.replay)
        most = self.replay // self.rollout * self.rollout
        rule = f"loss.warmup must be at most {most}, the decisions of loss.replay"
        require(self.warmup <= most, rule, self.warmup)


class QConvolutions(nn.Module):
    """Three convolutions, from views ``[*B, H, W, C]`` to ``[*B, code_dim]``.

    Reference:
        Mnih et al., "Human-level control through deep reinforcement learning" (2015).

    Args:
        planes: number C of channels.
        size: height and width of the views in pixels.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, C, H, W]``.

    Examples:
        >>> convolutions = QConvolutions(12, size=84)
        >>> convolutions(torch.zeros(5, 84, 84, 12, dtype=torch.uint8)).shape
        torch.Size([5, 3136])
    """

    def __init__(
        self, planes: int, *, size: int, channels: ChannelOrder = "HWC"
    ) -> None:
        super().__init__()
        self.channels = check_order(channels)
        square = (size, size)
        self.shape = (*square, planes) if channels == "HWC" else (planes, *square)
        self.net = ConvNet(
            in_features=planes,
            num_cells=list(_CHANNELS),
            kernel_sizes=list(_WIDTHS),
            strides=list(_STRIDES),
            activation_class=nn.ReLU,
        )
        for width, stride in zip(_WIDTHS, _STRIDES, strict=True):
            size = (size - width) // stride + 1
        self.code_dim = _CHANNELS[-1] * size**2

    def forward(self, views: Tensor) -> Tensor:
        if tuple(views.shape[-3:]) != self.shape:
            rule = f"views must end in the shape {list(self.shape)}"
            given = f"channels={self.channels!r}, got {list(views.shape)}"
            raise ValueError(f"{rule} with {given}.")
        planes = channels_last(views, self.channels).movedim(-1, -3)
        code: Tensor = self.net(planes.float() / 255)
        return code


class QPolicy(TensorDictSequential):
    """The action of the highest value, or any with the probability ``epsilon``.

    Args:
        network: writes ``action_value`` and, under ``next``, its state.
        primer: makes the transform that starts the state at a reset.
        num_actions: number A of actions.
    """

    def __init__(
        self, network: TensorDictModuleBase, primer: Any, *, num_actions: int
    ) -> None:
        value = QValueModule(action_space="categorical")
        explore = EGreedyModule(Categorical(num_actions))
        super().__init__(TensorDictSequential(network, value), explore)
        self._primer, self.num_actions = primer, num_actions

    @property
    def value_network(self) -> TensorDictModuleBase:
        """The policy without its random actions."""
        return self.module[0]

    @property
    def epsilon(self) -> Tensor:
        """Probability of a random action, a buffer that is published like weights."""
        eps: Tensor = self.module[1].eps
        return eps

    def make_tensordict_primer(self) -> StatePrimer:
        """Starts the state at zero, in an env whose actions are numbers, too."""
        states = self._primer().primers
        return StatePrimer(states, num_actions=self.num_actions, one_hot=False)


class QLearner(Learner):
    """Learns the values of actions from replayed slices, by TorchRL's ``DQNLoss``.

    The reward is multiplied by ``reward_scale``. Reaching a goal that moves the agent
    elsewhere ends nothing: the value of the new place counts, as it does for the
    actor-critics. The replay is not in a checkpoint; a resumed run first fills it.
    """

    schema = QConfig
    config: QConfig
    policy: QPolicy
    saved: Sequence[str] = ("policy", "loss", "optimizer", "updates", "owed")

    def __init__(self, settings: ExploreConfig, world: World, **given: Any) -> None:
        super().__init__(settings, world, **given)
        config, self.updates, self.owed = self.config, 0, 0
        self.replay = SliceReplay(
            config.replay,
            length=config.slice_length,
            view=keys.POLICY_PIXELS,
            reward=self.reward,
        )
        self.in_keys = self.replay.in_keys
        self.loss = DQNLoss(
            self.policy.value_network,
            loss_function="smooth_l1",
            action_space="categorical",
        )
        self.loss.make_value_estimator(gamma=config.gamma)
        # Its own count of updates would start again in a resumed run.
        self.target = HardUpdate(self.loss, value_network_update_interval=0)
        weights = self.policy.parameters()
        self.optimizer = torch.optim.Adam(weights, lr=config.lr, eps=config.eps)

    @classmethod
    def make_policy(cls, settings: ExploreConfig, world: World) -> QPolicy:
        """A fresh policy, which acts at random."""
        policy = settings.policy
        rule = f"policy.input must be pixels with loss={settings.loss.name}"
        require(policy.input == "pixels", rule, policy.input)
        rule = f"policy.layers must be 1 with loss={settings.loss.name}"
        require(policy.layers == 1, rule, policy.layers)
        return cls.make_network(settings, world.spec.num_actions)

    @staticmethod
    @abstractmethod
    def make_network(settings: ExploreConfig, num_actions: int) -> QPolicy:
        """The policy of A actions that see pixels."""

    @abstractmethod
    def make_batch(self, slices: TensorDictBase) -> TensorDictBase:
        """What the loss gets, from slices ``[B, L]``."""

    def compute_loss(self, batch: TensorDictBase) -> Tensor:
        """The loss of what `make_batch` made."""
        loss: Tensor = self.loss(batch)["loss"]
        return loss

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Remember a batch ``[E, T]``, and learn so often as it has decisions for.

        Returns:
            The mean loss of its updates, NaN while the replay fills, the probability of
            random actions, and the learning rate.
        """
        config, progress = self.config, self.progress()
        until = max(config.epsilon_until, 1e-9)
        epsilon = linear_decay(config.epsilon, progress / until)
        self.policy.epsilon.fill_(epsilon)
        lr = config.lr * linear_decay(config.final_lr, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = lr
        self.replay.extend(batch.cpu())
        losses = []
        if len(self.replay) >= config.warmup:
            self.owed += batch.numel()
            while self.owed >= config.every:
                self.owed -= config.every
                losses.append(self._step())
        mean = sum(losses) / len(losses) if losses else math.nan
        return {"loss_value": mean, "epsilon": epsilon, "lr": lr}

    def _step(self) -> float:
        """One update; returns its loss."""
        slices = self.replay.sample(self.config.batch).to(self.device)
        reward = ("next", keys.REWARD)
        slices[reward] = slices[reward] * self.config.reward_scale
        loss = self.compute_loss(self.make_batch(slices))
        measured = {"loss_value": float(loss.detach())}
        self.check(measured, self.updates)
        self.optimizer.zero_grad()
        loss.backward()
        norm = clip_grad_norm_(self.policy.parameters(), self.config.max_grad_norm)
        self.check({"gradient_norm": float(norm)}, self.updates)
        self.optimizer.step()
        self.updates += 1
        if self.updates % self.config.target_every == 0:
            self.target.step()
        return measured["loss_value"]

    def synchronise(self) -> None:
        self.target.step()

    def settle(self, policy: TensorDictModuleBase) -> None:
        """Nearly greedy from now on, with the probability ``test_epsilon``."""
        assert isinstance(policy, QPolicy)
        policy.epsilon.fill_(self.config.test_epsilon)
