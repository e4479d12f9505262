"""`GoalViews`: shows each env's agent its goal, in views taken before."""

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite

from toponav.keys import GOAL_CELL, GOAL_VIEWS
from toponav.transforms.specs import KeyedTransform, Keys, find_spec


class GoalViews(KeyedTransform):
    """Writes views of the goal's place, for agents that must not know its cell.

    Args:
        cells: int64 ``[K, 2]``, row and column of the places where a goal can be.
        views: uint8 ``[K, V, H, W, C]``, V views of each.
        in_keys: key of the goal's cell, int64 ``[*B, 2]``, one of ``cells``.
        out_keys: key of the views, uint8 ``[*B, V, H, W, C]``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> cells = torch.tensor([[1, 1], [1, 2]])
        >>> views = torch.arange(2, dtype=torch.uint8).reshape(2, 1, 1, 1, 1)
        >>> start = TensorDict({GOAL_CELL: torch.tensor([[1, 2], [1, 1]])}, [2])
        >>> show = GoalViews(cells, views)
        >>> show._reset(TensorDict(batch_size=[2]), start)["goal_views"].flatten()
        tensor([1, 0], dtype=torch.uint8)
    """

    default_keys = [GOAL_CELL], [GOAL_VIEWS]
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
            raise ValueError(
                f"views must be [{len(cells)}, V, H, W, C], some of each cell, got "
                f"{tuple(views.shape)}"
            )
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
        # The goal stays where it is: what was shown before, if it is still there.
        shown = tensordict.get(self.out_keys[0], None)
        if shown is None:
            return self._show(next_tensordict)
        return next_tensordict.set(self.out_keys[0], shown)

    def _show(self, tensordict: TensorDictBase) -> TensorDictBase:
        goal = tensordict[self.in_keys[0]]
        self.to(goal.device)
        is_at = (goal.unsqueeze(-2) == self.cells).all(-1)
        unknown = goal[~is_at.any(-1)].tolist()
        if unknown:
            key = self.in_keys[0]
            raise ValueError(f"{key!r} must be a cell with views, got {unknown[0]}")
        return tensordict.set(self.out_keys[0], self.views[is_at.int().argmax(-1)])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        goal = find_spec(observation_spec, self.in_keys[0], length=2)
        shape = (*goal.shape[:-1], *self.views.shape[1:])
        shown = Bounded(0, 255, shape, goal.device, self.views.dtype)
        return observation_spec.set(self.out_keys[0], shown)
