"""DRQN: values of actions from the view and a memory."""

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import LSTMModule, set_recurrent_mode
from torchrl.objectives.value import TD0Estimator

from toponav.builders import World
from toponav.config import ExploreConfig, at_least
from toponav.keys import ACTION_VALUE, HIDDEN, IS_INIT, MEMORY_CELL, POLICY_PIXELS
from toponav.methods.learners.q_learner import (
    QConfig,
    QConvolutions,
    QLearner,
    QPolicy,
)


@dataclass
class DRQNConfig(QConfig):
    """Settings of ``loss=drqn``."""

    unroll: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_slices("unroll")

    @property
    def slice_length(self) -> int:
        return self.unroll


class DRQNLearner(QLearner):
    """DQN with an LSTM in place of its first linear layer, fed one view at a time.

    It learns from slices anywhere in an episode, each from an empty memory, and so does
    the older copy, which says what follows: both remember the views of the slice alone,
    and none of an episode before.

    Reference:
        Hausknecht and Stone, "Deep Recurrent Q-Learning for Partially Observable MDPs"
        (2015), "bootstrapped random updates".
    """

    schema = DRQNConfig
    config: DRQNConfig

    def __init__(self, settings: ExploreConfig, world: World, **given: Any) -> None:
        super().__init__(settings, world, **given)
        # TorchRL would begin the older copy where the slice has no memory, or that of
        # the episode before. Without a network it reads what is written here.
        estimator = TD0Estimator(gamma=self.config.gamma, value_network=None)
        estimator.set_keys(value=self.loss.tensor_keys.value)
        self.loss.make_value_estimator(estimator)

    @staticmethod
    def make_network(settings: ExploreConfig, num_actions: int) -> QPolicy:
        hidden = settings.policy.hidden
        convolutions = QConvolutions(3, size=settings.policy.view_size)
        states = [("next", *HIDDEN), ("next", *MEMORY_CELL)]
        lstm = LSTMModule(
            input_size=convolutions.code_dim,
            hidden_size=hidden,
            in_keys=["code", HIDDEN, MEMORY_CELL],
            out_keys=["memory", *states],
        )
        network = TensorDictSequential(
            TensorDictModule(convolutions, in_keys=[POLICY_PIXELS], out_keys=["code"]),
            lstm,
            TensorDictModule(
                nn.Linear(hidden, num_actions),
                in_keys=["memory"],
                out_keys=[ACTION_VALUE],
            ),
        )
        primer = lstm.make_tensordict_primer
        return QPolicy(network, primer, num_actions=num_actions)

    def make_batch(self, slices: TensorDictBase) -> TensorDictBase:
        return slices

    def compute_loss(self, batch: TensorDictBase) -> Tensor:
        with set_recurrent_mode(True):
            value: NestedKey = ("next", self.loss.tensor_keys.value)
            return super().compute_loss(batch.copy().set(value, self._following(batch)))

    @torch.no_grad()
    def _following(self, batch: TensorDictBase) -> Tensor:
        """Values ``[B, L, 1]`` of the views after each decision, by the older copy."""
        seen = {
            key: torch.cat([batch[key][:, :1], batch["next", key]], 1)
            for key in (POLICY_PIXELS, IS_INIT)
        }
        views = TensorDict(seen, [len(batch), self.config.unroll + 1])
        network = self.loss.value_network
        with self.loss.target_value_network_params.to_module(network):
            values: Tensor = network(views)[self.loss.tensor_keys.value]
        return values[:, 1:]
