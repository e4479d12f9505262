"""`GoalViews`: shows each env's agent its goal, in pictures taken before."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs.transforms import Transform

from toponav.keys import GOAL_CELL, GOAL_VIEWS


class GoalViews(Transform):
    """Writes the pictures of the goal's place at an episode's start.

    The task is posed here: who poses it knows where the goal is and which pictures were
    taken there, so this transform reads the privileged goal cell. What the agent gets
    are the pictures alone, the same in all decisions of an episode.

    Args:
        cells: int64 ``[K, 2]``, row and column of the places where a goal can be.
        views: uint8 ``[K, V, H, W, C]``, V pictures of each.
        in_keys: key of the goal's cell, int64 ``[*B, 2]``.
        out_keys: key of the pictures, uint8 ``[*B, V, H, W, C]``.

    Raises:
        ValueError: if there are not as many pictures as cells; when the env's specs are
            read, if the goal's cell is missing; at a reset, if the goal is in a cell
            without pictures.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> cells = torch.tensor([[1, 1], [1, 2]])
        >>> pictures = torch.arange(2, dtype=torch.uint8).reshape(2, 1, 1, 1, 1)
        >>> show = GoalViews(cells, pictures)
        >>> start = TensorDict({GOAL_CELL: torch.tensor([[1, 2], [1, 1]])}, [2])
        >>> show._reset(TensorDict(batch_size=[2]), start)["goal_views"].flatten()
        tensor([1, 0], dtype=torch.uint8)

    Shape notation:
        B: batch of environments.  K: places.  V: pictures of each.  H, W, C: height,
        width, channels.
    """

    cells: Tensor
    views: Tensor

    def __init__(
        self,
        cells: Tensor,
        views: Tensor,
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if views.ndim != 5 or len(views) != len(cells) or not views.shape[1]:
            raise ValueError(
                f"views must be [{len(cells)}, V, H, W, C], some of each cell, got "
                f"{tuple(views.shape)}"
            )
        super().__init__(
            in_keys=[GOAL_CELL] if in_keys is None else in_keys,
            out_keys=[GOAL_VIEWS] if out_keys is None else out_keys,
        )
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
        goal = tensordict.get(self.in_keys[0])
        if goal.device != self.cells.device:
            self.to(goal.device)
        is_at = (goal.unsqueeze(-2) == self.cells).all(-1)
        if not bool(is_at.any(-1).all()):
            cell = goal[~is_at.any(-1)][0].tolist()
            raise ValueError(
                f"{self.in_keys[0]!r} must be a cell with pictures, got {cell}; it has "
                f"{len(self.cells)} cells, the first {self.cells[0].tolist()}"
            )
        number = is_at.int().argmax(-1)
        return tensordict.set(self.out_keys[0], self.views[number])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        key = self.in_keys[0]
        if key not in observation_spec.keys(True, True):
            raise ValueError(f"{key!r} must be an observation of the env, got none")
        goal = observation_spec[key]
        observation_spec[self.out_keys[0]] = Bounded(
            0,
            255,
            shape=(*goal.shape[:-1], *self.views.shape[1:]),
            dtype=self.views.dtype,
            device=goal.device,
        )
        return observation_spec
