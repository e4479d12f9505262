"""Lists of transforms that belong together: for novelty, and for a policy's inputs.

No ``Compose`` of their own: TorchRL does not find the env of one inside another.
"""

from typing import Any, Protocol

from tensordict import NestedKey
from torch import Tensor
from torchrl.envs import InitTracker
from torchrl.envs.transforms import Transform

from toponav import keys
from toponav.parts import require_parts
from toponav.transforms.agent_inputs import PreviousAction, PreviousReward
from toponav.transforms.novelty_rewards import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
)
from toponav.transforms.waypoint_memory import WaypointMemory


class Comparing(Protocol):
    """What `make_novelty_reward` asks of a network, such as `TCNetwork`."""

    def embed(self, pixels: Tensor) -> Tensor:
        """Views ``[N, H, W, C]`` to embeddings ``[N, D]``."""

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """``[N, M, D]`` to ``[N, M, P]``."""

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """``[N, D]`` and ``[N, M, P]`` to similarities ``[N, M]``, 0 to 1."""


class RecurrentPolicy(Protocol):
    """What `make_policy_inputs` asks of a policy, such as `ActorCritic`."""

    num_actions: int

    def make_tensordict_primer(self) -> Transform:
        """What starts its state at zero."""


def make_novelty_reward(
    network: Comparing, threshold: float, *, alpha: float = 0.2, **memory: Any
) -> list[Transform]:
    """What pays for novelty: a `WaypointMemory`, its two rewards and their sum.

    Known places pay by their visits, new ones by temporal distance (eqs. 6 to 8), as
    ``intrinsic_reward``.

    Args:
        network: such as a `TCNetwork`, in ``eval()`` mode.
        threshold: similarity above which a place is known, in [0, 1); `calibrate_share`
            finds it.
        alpha: weight of the count reward, in [0, 1]; the other's is 1 - alpha.
        memory: more arguments of `WaypointMemory`.

    Examples:
        >>> from toponav.modules import ConcatComparator, SmallEncoder, TCNetwork
        >>> encoder = SmallEncoder(8, image_size=(24, 32))
        >>> network = TCNetwork(encoder, ConcatComparator(8, hidden=[8])).eval()
        >>> [type(one).__name__ for one in make_novelty_reward(network, threshold=0.5)]
        ['WaypointMemory', 'CountReward', 'TemporalDistanceReward', 'IntrinsicReward']
    """
    if not 0 <= alpha <= 1:
        raise ValueError(f"alpha must be in [0, 1], got {alpha}")
    wanted = ("embed", "prepare_memory", "compare_prepared")
    require_parts(network, "network", "a TCNetwork", *wanted)
    seen = WaypointMemory(
        network.embed,
        network.compare_prepared,
        prepare=network.prepare_memory,
        threshold=threshold,
        **memory,
    )
    pay = CountReward(alpha), TemporalDistanceReward(1 - alpha), IntrinsicReward()
    return [seen, *pay]


def make_policy_inputs(
    policy: RecurrentPolicy, *, reward: NestedKey = keys.INTRINSIC_REWARD
) -> list[Transform]:
    """All that an `ActorCritic` reads beside its view; they follow view and reward.

    TorchRL's ``InitTracker``, `PreviousAction`, `PreviousReward` and the primer of the
    policy's state.

    Args:
        policy: such as an `ActorCritic`.
        reward: key of the reward that the policy learns from and reads, ``[*B, 1]``.

    Examples:
        >>> from toponav.modules import ActorCritic
        >>> policy = ActorCritic(num_actions=4, embedding_dim=8)
        >>> [type(one).__name__ for one in make_policy_inputs(policy)][:3]
        ['InitTracker', 'PreviousAction', 'PreviousReward']
    """
    wanted = ("num_actions", "make_tensordict_primer")
    require_parts(policy, "policy", "an ActorCritic", *wanted)
    return [
        InitTracker(),
        PreviousAction(policy.num_actions),
        PreviousReward(in_keys=[reward]),
        policy.make_tensordict_primer(),
    ]
