"""`Episodes` and `find_episodes`: where a storage's episodes lie."""

from dataclasses import dataclass

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import find_start_stop_traj
from torchrl.data.replay_buffers import Storage


@dataclass(frozen=True)
class Episodes:
    """Runs of successive decisions, laid one after the other.

    Frame ``t`` of run ``r`` is row ``order[start[r] + t]`` of the storage. A run is a
    whole episode, or what a ring buffer has left of one. Where frames are missing
    inside an episode it falls into several runs, which lie side by side and share
    their group.

    Args:
        order: int64 ``[N]``; rows of the storage, flat over all its dimensions.
        start: int64 ``[R]``; first place of each run in ``order``, ascending.
        length: int64 ``[R]``; decisions in each run.
        first_step: int64 ``[R]``; number of each run's first decision, comparable
            between the runs of one episode.
        group_start: int64 ``[R]``; first place of the run's episode in ``order``.
        group_length: int64 ``[R]``; frames of the run's episode.

    Examples:
        >>> episodes = Episodes.from_lengths([3, 2])
        >>> episodes.start, episodes.run_of(torch.tensor([0, 2, 3]))
        (tensor([0, 3]), tensor([0, 0, 1]))

    Shape notation:
        N: frames.  R: runs.
    """

    order: Tensor
    start: Tensor
    length: Tensor
    first_step: Tensor
    group_start: Tensor
    group_length: Tensor

    @classmethod
    def from_lengths(
        cls, length: list[int] | Tensor, order: Tensor | None = None
    ) -> "Episodes":
        """Lay out runs, each an episode of its own.

        Args:
            length: ``[R]``; decisions in each run.
            order: ``[N]``; rows of the storage, by default in ascending order.
        """
        length = torch.as_tensor(length, dtype=torch.int64)
        start = length.cumsum(0) - length
        if order is None:
            order = torch.arange(int(length.sum()))
        return cls(order, start, length, torch.zeros_like(start), start, length)

    def run_of(self, place: Tensor) -> Tensor:
        """The run to which places in ``order`` belong."""
        return torch.searchsorted(self.start, place, right=True) - 1

    @property
    def longest(self) -> int:
        """Decisions in the longest run, 0 without any."""
        return int(self.length.max()) if len(self.length) else 0


def find_episodes(
    storage: Storage,
    *,
    end_key: NestedKey = ("next", "done"),
    trajectory_key: NestedKey | None = None,
    step_key: NestedKey = "step_count",
) -> Episodes:
    """Find the episodes in a storage of any number of dimensions, time first.

    By default successive rows are successive decisions, episodes end where
    ``end_key`` is true, and at the place of the last write. Several collectors that
    take turns in one flat storage break that, and so does a full storage loaded from
    disk, where TorchRL keeps no note of the last write: give ``trajectory_key`` then,
    and frames are put in order by trajectory and step, wherever they lie.

    Args:
        storage: a ``LazyTensorStorage`` or ``LazyMemmapStorage`` of tensordicts.
        end_key: bool, ``[*B, 1]``; the episode ends after this decision.
        trajectory_key: int, ``[*B]`` or ``[*B, 1]``; a number per episode, unique in
            the storage. With it ``end_key`` is not read.
        step_key: int, ``[*B]`` or ``[*B, 1]``; the decision's number in its episode.

    Raises:
        ValueError: if a trajectory has two frames of the same step, or a full storage
            does not know where it was written last.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, ReplayBuffer
        >>> buffer = ReplayBuffer(storage=LazyTensorStorage(10))
        >>> done = torch.tensor([0, 0, 1, 0, 0], dtype=torch.bool).unsqueeze(-1)
        >>> _ = buffer.extend(TensorDict({"next": {"done": done}}, [5]))
        >>> find_episodes(buffer.storage).length
        tensor([3, 2])
    """
    if len(storage) == 0:
        return Episodes.from_lengths([])
    data = storage[:]
    if trajectory_key is not None:
        trajectory = data.get(trajectory_key).reshape(data.numel(), -1)[:, 0].cpu()
        step = data.get(step_key).reshape(data.numel(), -1)[:, 0].cpu()
        return _sort_into_episodes(trajectory, step)
    # SliceSampler's own two readings of a ring: is it full, and where is its seam.
    is_full, last_write = storage._is_full, storage._last_cursor_index
    if is_full and last_write is None:
        raise ValueError(
            "a full storage must know its last write to tell episodes apart, got one "
            "that was just loaded; write to it once, or pass trajectory_key."
        )
    end = data.get(end_key).reshape(data.shape).cpu()
    first, _, length = find_start_stop_traj(
        end=end, at_capacity=is_full, cursor=last_write
    )
    run = torch.repeat_interleave(torch.arange(len(length)), length)
    step = torch.arange(len(run)) - (length.cumsum(0) - length)[run]
    time = (first[run, 0] + step) % end.shape[0]
    width = end[0].numel()
    column = torch.zeros_like(time)
    for dim, size in enumerate(end.shape[1:], start=1):
        column = column * size + first[run, dim]
    return Episodes.from_lengths(length, time * width + column)


def _sort_into_episodes(trajectory: Tensor, step: Tensor) -> Episodes:
    """Runs of successive steps of one trajectory, wherever they are stored."""
    by_step = step.argsort(stable=True)
    order = by_step[trajectory[by_step].argsort(stable=True)]
    trajectory, step = trajectory[order], step[order]
    same = trajectory[1:] == trajectory[:-1]
    gap = step[1:] - step[:-1]
    if bool((same & (gap == 0)).any()):
        raise ValueError(
            "trajectory numbers must be unique in the storage, got two frames of the "
            "same trajectory and step; number the trajectories of a new run onwards."
        )
    is_first = torch.ones_like(trajectory, dtype=torch.bool)
    is_first[1:] = ~(same & (gap == 1))
    start = is_first.nonzero().squeeze(-1)
    length = torch.diff(start, append=torch.tensor([len(order)]))
    _, group_length = torch.unique_consecutive(trajectory, return_counts=True)
    group_start = group_length.cumsum(0) - group_length
    group = torch.searchsorted(group_start, start, right=True) - 1
    return Episodes(
        order,
        start,
        length,
        step[start],
        group_start[group],
        group_length[group],
    )
