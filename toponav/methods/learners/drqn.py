"""DRQN: values of actions from the view and a memory."""

from dataclasses import dataclass

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import LSTMModule, set_recurrent_mode

from toponav.config import ExploreConfig, at_least
from toponav.keys import ACTION_VALUE, HIDDEN, MEMORY_CELL, POLICY_PIXELS
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

    It learns from slices anywhere in an episode, each from an empty memory. The older
    copy, which says what follows, begins with what the network remembers of the first
    view.

    Reference:
        Hausknecht and Stone, "Deep Recurrent Q-Learning for Partially Observable MDPs"
        (2015), "bootstrapped random updates".
    """

    schema = DRQNConfig
    config: DRQNConfig

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
            # The loss hands these to the older copy, of which nothing is learned.
            TensorDictModule(_detach, in_keys=states, out_keys=states),
        )
        primer = lstm.make_tensordict_primer
        return QPolicy(network, primer, num_actions=num_actions)

    def make_batch(self, slices: TensorDictBase) -> TensorDictBase:
        return slices

    def compute_loss(self, batch: TensorDictBase) -> Tensor:
        with set_recurrent_mode(True):
            return super().compute_loss(batch)


def _detach(*states: Tensor) -> tuple[Tensor, ...]:
    return tuple(state.detach() for state in states)
