"""`SliceReplay`: the last decisions of an exploration, drawn in short slices."""

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import LazyTensorStorage, SliceSampler, TensorDictReplayBuffer

from toponav.keys import ACTION, DONE, IS_INIT, REWARD, TERMINATED, read_entry

# Which batch and row a decision came with: slices do not reach over it.
_PIECE = "piece"
#: Where TorchRL's losses look for what counts.
MASK: NestedKey = ("collector", "mask")


class SliceReplay:
    """Keeps the last decisions and draws slices of them, uniformly and with return.

    Each view is stored once, and the view after a decision is that of the next one. A
    row of a batch is a piece, whose last view closes it. A slice lies in one piece and
    may reach over the end of an episode, which ``is_init`` shows; the decision that a
    time limit ended has no view after it and is masked.

    Args:
        capacity: decisions that are kept, at least one batch of them.
        length: decisions L of a slice.
        view: key of the views.
        reward: key of the reward to learn from.

    Examples:
        >>> replay = SliceReplay(64, length=2, view="pixels", reward="reward")
        >>> flags = torch.zeros(4, 8, 1, dtype=torch.bool)
        >>> views = torch.arange(9).expand(4, 9)
        >>> now = {"pixels": views[:, :-1], "action": views[:, :-1], "is_init": flags}
        >>> later = {"pixels": views[:, 1:], "reward": torch.ones(4, 8, 1)}
        >>> later |= {"done": flags, "terminated": flags}
        >>> replay.extend(TensorDict({**now, "next": later}, [4, 8]))
        >>> slices = replay.sample(3)
        >>> (slices["next", "pixels"] - slices["pixels"]).tolist()
        [[1, 1], [1, 1], [1, 1]]
    """

    def __init__(
        self, capacity: int, *, length: int, view: NestedKey, reward: NestedKey
    ) -> None:
        if min(capacity, length) < 1:
            got = f"{capacity} and {length}"
            raise ValueError(f"capacity and length must be at least 1, got {got}")
        self.capacity, self.length = capacity, length
        self.view, self.reward = view, reward
        later = [view, reward, DONE, TERMINATED]
        #: What `extend` reads.
        self.in_keys: list[NestedKey] = [view, ACTION, IS_INIT]
        self.in_keys += [unravel_key(("next", key)) for key in later]
        self._buffer: TensorDictReplayBuffer | None = None
        self._pieces = self._rows = 0

    def __len__(self) -> int:
        """Decisions that are kept; the closing view of each piece counts as none."""
        if self._buffer is None:
            return 0
        return len(self._buffer) // (self._rows + 1) * self._rows

    def extend(self, batch: TensorDictBase) -> None:
        """Add a batch ``[E, T]``; all batches must have the same T.

        Raises:
            KeyError: if one of `in_keys` is missing.
            ValueError: if the batch is not ``[E, T]``, or T is another one than before,
                or shorter than a slice.
        """
        if batch.ndim != 2:
            got = list(batch.shape)
            raise ValueError(f"batches must be [E, T], a row an env, got {got}")
        read = {key: read_entry(batch, key) for key in self.in_keys}
        num, rows = batch.shape
        if self._buffer is None:
            self._start(num, rows)
        if rows != self._rows:
            raise ValueError(f"batches must be [E, {self._rows}], got {[num, rows]}")
        assert self._buffer is not None
        view, action, is_init, last, reward, done, terminated = read.values()
        entries = {
            self.view: _close(view, last[:, -1:]),
            ACTION: _close(action),
            IS_INIT: _close(is_init),
            REWARD: _close(reward),
            DONE: _close(done),
            TERMINATED: _close(terminated),
        }
        numbers = self._pieces + torch.arange(num).unsqueeze(-1)
        entries[_PIECE] = numbers.expand(num, rows + 1)
        self._pieces += num
        self._buffer.extend(TensorDict(entries, [num, rows + 1]).reshape(-1))

    def sample(self, num: int) -> TensorDict:
        """Slices ``[num, L]`` with what a loss of TorchRL reads, and its mask.

        Raises:
            ValueError: before the first `extend`.
        """
        if self._buffer is None:
            raise ValueError("the replay must hold a batch to draw from, got none")
        drawn = self._buffer.sample(num * (self.length + 1))
        drawn = drawn.reshape(num, self.length + 1)
        now, later = drawn[:, :-1], drawn[:, 1:]
        names = (REWARD, DONE, TERMINATED)
        following = {name: now[name] for name in names}
        following |= {name: later[name] for name in (self.view, IS_INIT)}
        entries = {name: now[name] for name in (self.view, ACTION, IS_INIT)}
        slices = TensorDict({**entries, "next": following}, now.batch_size)
        return slices.set(MASK, ~now[DONE] | now[TERMINATED])

    def _start(self, num: int, rows: int) -> None:
        if rows < self.length:
            raise ValueError(
                f"batches must have at least {self.length} decisions of each "
                f"environment, a slice, got {rows}"
            )
        self._rows = rows
        # Whole pieces, so that none is ever half overwritten.
        pieces = max(self.capacity // rows, num)
        sampler = SliceSampler(
            slice_len=self.length + 1,
            traj_key=_PIECE,
            cache_values=True,
            truncated_key=None,
            init_key=None,
        )
        storage = LazyTensorStorage(pieces * (rows + 1))
        self._buffer = TensorDictReplayBuffer(storage=storage, sampler=sampler)


def _close(entry: Tensor, last: Tensor | None = None) -> Tensor:
    """An entry ``[E, T, ...]`` with one more row, zeros unless given."""
    last = torch.zeros_like(entry[:, :1]) if last is None else last
    return torch.cat([entry, last], 1)
