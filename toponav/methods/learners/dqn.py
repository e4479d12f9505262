"""DQN: values of actions from the last few views, without a memory."""

from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.data import Unbounded
from torchrl.envs.transforms import TensorDictPrimer

from toponav.config import ExploreConfig, at_least
from toponav.data import MASK
from toponav.keys import (
    ACTION,
    ACTION_VALUE,
    FRAMES,
    IS_INIT,
    POLICY_PIXELS,
    read_entry,
)
from toponav.methods.learners.q_learner import (
    QConfig,
    QConvolutions,
    QLearner,
    QPolicy,
)
from toponav.views import ChannelOrder, check_views


@dataclass
class DQNConfig(QConfig):
    """Settings of ``loss=dqn``."""

    frames: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_slices("frames")

    @property
    def slice_length(self) -> int:
        return self.frames


class StackedQNetwork(TensorDictModuleBase):
    """Values of actions from a view and the K - 1 views before it.

    The earlier views are its state: they ride in the tensordict, and it hands on the
    newest ones.

    Args:
        num_actions: number A of actions.
        size: height and width of the views in pixels.
        frames: number K of views.
        hidden: width of the layer after the convolutions.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, 3, H, W]``.

    Examples:
        >>> network = StackedQNetwork(6, size=36, frames=4, hidden=16)
        >>> views = {POLICY_PIXELS: torch.zeros(5, 36, 36, 3, dtype=torch.uint8)}
        >>> views[FRAMES] = torch.zeros(5, 36, 36, 9, dtype=torch.uint8)
        >>> network(TensorDict(views, [5]))["action_value"].shape
        torch.Size([5, 6])
    """

    in_keys = [POLICY_PIXELS, FRAMES]
    out_keys = [ACTION_VALUE, ("next", *FRAMES)]

    def __init__(
        self,
        num_actions: int,
        *,
        size: int,
        frames: int,
        hidden: int,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        self.convolutions = QConvolutions(3 * frames, size=size, channels=channels)
        # Where the channels are.
        self.dim = -1 if channels == "HWC" else -3
        head = nn.Linear(self.convolutions.code_dim, hidden)
        self.head = nn.Sequential(head, nn.ReLU(), nn.Linear(hidden, num_actions))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        seen = [read_entry(tensordict, key) for key in (FRAMES, POLICY_PIXELS)]
        check_views(repr(POLICY_PIXELS), seen[1].shape, self.convolutions.channels)
        stack = torch.cat(seen, self.dim)
        tensordict.set(ACTION_VALUE, self.head(self.convolutions(stack)))
        newest = stack.narrow(self.dim, 3, stack.shape[self.dim] - 3)
        return tensordict.set(("next", *FRAMES), newest)


class DQNLearner(QLearner):
    """A feed-forward network on a stack of views, and a target network.

    Reference:
        Mnih et al., "Human-level control through deep reinforcement learning" (2015).
    """

    schema = DQNConfig
    config: DQNConfig

    @staticmethod
    def make_network(settings: ExploreConfig, num_actions: int) -> QPolicy:
        assert isinstance(settings.loss, DQNConfig)
        size, frames = settings.policy.view_size, settings.loss.frames
        network = StackedQNetwork(
            num_actions, size=size, frames=frames, hidden=settings.policy.hidden
        )
        black = Unbounded((size, size, 3 * (frames - 1)), dtype=torch.uint8)
        primer = partial(TensorDictPrimer, {FRAMES: black}, expand_specs=True)
        return QPolicy(network, primer, num_actions=num_actions)

    def make_batch(self, slices: TensorDictBase) -> TensorDict:
        """The last decision of each slice ``[B, L]``, with the views before it."""
        views, now, later = slices[POLICY_PIXELS], slices[:, -1], slices["next"][:, -1]
        # A view counts if no episode has begun after it.
        begun = slices[IS_INIT][:, 1:].flip(1).cumsum(1).flip(1).squeeze(-1) > 0
        earlier = views[:, :-1]
        if begun.any():
            earlier = earlier.masked_fill(begun.reshape(*begun.shape, 1, 1, 1), 0)
        # The oldest first. After the decision it is gone, unless it is all there is.
        stack = torch.cat([*earlier.unbind(1), views[:, -1]], -1)
        entries = {
            POLICY_PIXELS: views[:, -1],
            ACTION: now[ACTION],
            MASK: now[MASK],
            FRAMES: stack[..., :-3],
            "next": later.set(FRAMES, stack[..., 3:]),
        }
        return TensorDict(entries, now.batch_size)
