"""What an agent is told beside its view: its last action and reward, its goal.

Reference:
    The paper, "Model implementation": an LSTM is fed the previous action and reward.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, Unbounded

from toponav import keys
from toponav.actions import as_numbers, count_actions
from toponav.keys import read_entry
from toponav.transforms.specs import (
    KeyedTransform,
    Keys,
    find_spec,
    move_to,
)


class PreviousAction(KeyedTransform):
    """Writes the action that led to an observation; ``num_actions`` if there is none.

    It is the action as the transforms that follow it, and the policy, see it.

    Args:
        num_actions: how many actions the env has, at least 2.
        in_keys: key of the action, int64 ``[*B]``, ``[*B, 1]`` or one-hot.
        out_keys: key of the action before, int64 ``[*B, 1]`` in ``[0, num_actions]``.

    Examples:
        >>> start = TensorDict(batch_size=[2])
        >>> PreviousAction(4)._reset(start, start)["previous_action"].squeeze(-1)
        tensor([4, 4])
    """

    default_keys = [keys.ACTION], [keys.PREVIOUS_ACTION]

    def __init__(
        self, num_actions: int, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}")
        super().__init__(in_keys, out_keys)
        self.num_actions = num_actions
        self._chosen = f"_{self.out_keys[0]}"

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        # `_step` sees what the env was given, which transforms before this one change.
        action = tensordict.get(self.in_keys[0], None)
        return tensordict if action is None else tensordict.set(self._chosen, action)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        action = tensordict.get(self._chosen, None)
        if action is None:
            action = read_entry(tensordict, self.in_keys[0])
        numbers = as_numbers(action, tensordict.batch_size, self.num_actions)
        return next_tensordict.set(self.out_keys[0], numbers.unsqueeze(-1))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        shape, device = (*tensordict_reset.batch_size, 1), tensordict_reset.device
        none = torch.full(shape, self.num_actions, device=device)
        return tensordict_reset.set(self.out_keys[0], none)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        key = self.in_keys[0]
        action = find_spec(self.parent.full_action_spec, key, kind="an action")
        if (number := count_actions(action, key)) != self.num_actions:
            raise ValueError(
                f"num_actions must be that of {key!r}, {number}, got {self.num_actions}"
            )
        shape, device = (*observation_spec.shape, 1), observation_spec.device
        spec = Categorical(self.num_actions + 1, shape, device)
        return observation_spec.set(self.out_keys[0], spec)


class PreviousReward(KeyedTransform):
    """Writes the reward that came with an observation, clipped; 0 after a reset.

    Args:
        clip: rewards are cut to ``[-clip, clip]``.
        in_keys, out_keys: keys of the reward and of the clipped one, ``[*B, 1]``.

    Examples:
        >>> step = TensorDict({"intrinsic_reward": torch.tensor([[0.2], [16.0]])}, [2])
        >>> PreviousReward()._step(TensorDict(), step)["previous_reward"].squeeze(-1)
        tensor([0.2000, 1.0000])
    """

    default_keys = [keys.INTRINSIC_REWARD], [keys.PREVIOUS_REWARD]

    def __init__(
        self, clip: float = 1.0, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if not clip > 0:
            raise ValueError(f"clip must be above 0, got {clip}")
        super().__init__(in_keys, out_keys)
        self.clip = clip

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        reward = read_entry(next_tensordict, self.in_keys[0])
        clipped = reward.clamp(-self.clip, self.clip)
        return next_tensordict.set(self.out_keys[0], clipped)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        if self.parent is None:
            shape, device = tensordict_reset.batch_size, tensordict_reset.device
            start = torch.zeros(*shape, 1, device=device)
        else:
            specs = self.parent.full_reward_spec
            start = find_spec(specs, self.in_keys[0], kind="a reward").zero()
        return tensordict_reset.set(self.out_keys[0], start)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        # Asking `parent` for specs would compute those of all earlier transforms again.
        output_spec = output_spec.clone()
        rewards = output_spec["full_reward_spec"]
        reward = find_spec(rewards, self.in_keys[0], kind="a reward")
        bounds = (-self.clip, self.clip)
        spec = Bounded(*bounds, reward.shape, reward.device, reward.dtype)
        output_spec["full_observation_spec"][self.out_keys[0]] = spec
        return output_spec


class GoalViews(KeyedTransform):
    """Writes views of the goal's place, for agents that must not know its cell.

    Args:
        cells: int64 ``[K, 2]``, row and column of the places where a goal can be.
        views: uint8 ``[K, V, H, W, C]``, V views of each, or with channels first.
        in_keys: key of the goal's cell, int64 ``[*B, 2]``, one of ``cells``.
        out_keys: key of the views, uint8 ``[*B, V, H, W, C]``.

    Examples:
        >>> cells = torch.tensor([[1, 1], [1, 2]])
        >>> views = torch.arange(2, dtype=torch.uint8).reshape(2, 1, 1, 1, 1)
        >>> start = TensorDict({keys.GOAL_CELL: torch.tensor([[1, 2], [1, 1]])}, [2])
        >>> show = GoalViews(cells, views)
        >>> show._reset(TensorDict(batch_size=[2]), start)["goal_views"].flatten()
        tensor([1, 0], dtype=torch.uint8)
    """

    default_keys = [keys.GOAL_CELL], [keys.GOAL_VIEWS]
    cells: Tensor
    views: Tensor

    def __init__(
        self,
        cells: Tensor,
        views: Tensor,
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        if views.ndim != 5 or len(views) != len(cells) or not views.shape[1]:
            rule = f"views must be [{len(cells)}, V, H, W, C], some of each cell"
            raise ValueError(f"{rule}, got {tuple(views.shape)}")
        super().__init__(in_keys, out_keys)
        self.register_buffer("cells", cells.clone(), persistent=False)
        self.register_buffer("views", views.clone(), persistent=False)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._show(tensordict_reset)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        # A goal that has not moved: what was shown before, if it is still there.
        shown = tensordict.get(self.out_keys[0], None)
        before = tensordict.get(self.in_keys[0], None)
        goal = read_entry(next_tensordict, self.in_keys[0])
        if shown is None or before is None or not torch.equal(goal, before):
            return self._show(next_tensordict)
        return next_tensordict.set(self.out_keys[0], shown)

    def _show(self, tensordict: TensorDictBase) -> TensorDictBase:
        goal = read_entry(tensordict, self.in_keys[0])
        move_to(self, goal.device)
        is_at = (goal.unsqueeze(-2) == self.cells).all(-1)
        if unknown := goal[~is_at.any(-1)].tolist():
            rule = f"{self.in_keys[0]!r} must be a cell with views"
            raise ValueError(f"{rule}, got {unknown[0]}")
        return tensordict.set(self.out_keys[0], self.views[is_at.int().argmax(-1)])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        goal = find_spec(observation_spec, self.in_keys[0], length=2)
        shape = (*goal.shape[:-1], *self.views.shape[1:])
        shown = Unbounded(shape, goal.device, self.views.dtype)
        return observation_spec.set(self.out_keys[0], shown)
