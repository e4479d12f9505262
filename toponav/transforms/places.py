"""`PlacesVisited`: how many squares of the floor an episode has entered."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from toponav import keys
from toponav.keys import read_entry
from toponav.transforms.specs import (
    GrowingSlots,
    KeyedTransform,
    Keys,
    find_spec,
    move_to,
    require_reset,
    restarting_rows,
)


class PlacesVisited(GrowingSlots, KeyedTransform):
    """Counts the places that an env has been to in this episode, the first included.

    A place is a square of the floor. It is what can be said of a world that reports
    positions but has no plan; where there is one, `Coverage` says more. It reads
    privileged keys: no agent sees it.

    Args:
        size: side of a square, in units of the position, above 0.
        in_keys: key of the position, float32 ``[*B, 2]``.
        out_keys: key of the number of places, int64 ``[*B, 1]``.

    Examples:
        >>> meter = PlacesVisited(1.0)
        >>> def at(x):
        ...     return TensorDict({keys.POSITION: torch.tensor([[x, 0.5]])}, [1])
        >>> start = meter._reset(TensorDict(batch_size=[1]), at(0.2))
        >>> [meter._call(at(x))[keys.PLACES].item() for x in (0.9, 1.1, 0.3, -0.1)]
        [1, 2, 2, 3]
    """

    default_keys = [keys.POSITION], [keys.PLACES]
    squares: Tensor
    num_places: Tensor

    def __init__(
        self, size: float, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if not size > 0:
            raise ValueError(f"size must be above 0, got {size}")
        super().__init__(in_keys, out_keys)
        self.size = size
        # Row and column of each square, [N, A, 2], and their number, [N].
        self.register_buffer("squares", torch.empty(0, 0, 2, dtype=torch.int64))
        self.register_buffer("num_places", torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        position = read_entry(tensordict_reset, self.in_keys[0])
        move_to(self, position.device)
        shape = position.shape[:-1]
        rows = restarting_rows(self, tensordict, shape, position.device).reshape(-1)
        if len(self.num_places) != len(rows):
            self.squares = self.squares.new_zeros(len(rows), self.squares.shape[1], 2)
            self.num_places = self.num_places.new_zeros(len(rows))
        self.num_places = self.num_places * ~rows
        return self._count(tensordict_reset, rows)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        position = read_entry(next_tensordict, self.in_keys[0])
        require_reset(self.num_places.shape, [position.shape[:-1].numel()])
        return self._count(next_tensordict)

    def _count(
        self, tensordict: TensorDictBase, rows: Tensor | bool = True
    ) -> TensorDictBase:
        position = tensordict[self.in_keys[0]]
        square = (position / self.size).floor().long().reshape(-1, 2)
        self._make_room("squares", self.num_places)
        same = (self.squares == square.unsqueeze(1)).all(-1)
        slot = torch.arange(self.squares.shape[1], device=square.device)
        known = (same & (slot < self.num_places.unsqueeze(-1))).any(-1)
        is_new = ~known & rows
        at = (torch.arange(len(square), device=square.device), self.num_places)
        kept = torch.where(is_new.unsqueeze(-1), square, self.squares[at])
        self.squares[at] = kept
        self.num_places = self.num_places + is_new
        number = self.num_places.reshape(*position.shape[:-1], 1)
        return tensordict.set(self.out_keys[0], number.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        position = find_spec(observation_spec, self.in_keys[0], length=2)
        shape = (*position.shape[:-1], 1)
        spec = Unbounded(shape, position.device, torch.int64)
        return observation_spec.set(self.out_keys[0], spec)
