"""`Episodes` and `find_episodes`: where a storage's episodes lie."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data.replay_buffers import Storage

from toponav.keys import TRAJECTORY


@dataclass(frozen=True)
class Episodes:
    """Runs of successive decisions, laid one after the other.

    Frame ``t`` of run ``r`` is row ``order[start[r] + t]`` of the storage. A run is a
    whole episode, or what a ring buffer has left of one. An episode with missing frames
    is split into several runs, which lie side by side and share their group. All
    entries are int64.

    Examples:
        >>> episodes = Episodes.from_lengths([3, 2])
        >>> episodes.start, episodes.run_of(torch.tensor([0, 2, 3]))
        (tensor([0, 3]), tensor([0, 0, 1]))
    """

    order: Tensor  # [N]; rows of the storage, flat over all its dimensions
    start: Tensor  # [R]; first place of each run in `order`, ascending
    length: Tensor  # [R]; decisions in each run
    first_step: Tensor  # [R]; number of each run's first decision in its episode
    group_start: Tensor  # [R]; first place of the run's episode in `order`
    group_length: Tensor  # [R]; frames of the run's episode

    @classmethod
    def from_lengths(cls, length: list[int]) -> "Episodes":
        """Lay out whole episodes of these lengths; rows are in ascending order."""
        lengths = torch.as_tensor(length, dtype=torch.int64)
        start = lengths.cumsum(0) - lengths
        order = torch.arange(int(lengths.sum()))
        return cls(order, start, lengths, torch.zeros_like(start), start, lengths)

    def run_of(self, place: Tensor) -> Tensor:
        """The run to which places in ``order`` belong."""
        return torch.searchsorted(self.start, place, right=True) - 1

    def require(self, length: int, why: str) -> None:
        """ValueError if no run has ``length`` decisions; ``why`` is what needs them."""
        longest = int(self.length.max()) if len(self.length) else 0
        if longest < length:
            raise ValueError(
                f"the buffer must hold an episode of at least {length} decisions "
                f"({why}), got {longest} at most; collect more"
            )


def find_episodes(storage: Storage) -> Episodes:
    """Sort the frames of a storage of any number of dimensions by episode and step.

    Episodes come in the order of their first rows, whatever their numbers.

    Where they lie does not matter: several writers may take turns in one ring. The
    number of an episode must be unique in the storage.
    """
    if len(storage) == 0:
        return Episodes.from_lengths([])
    data = storage[:]
    found = {key: data.get(key, None) for key in (TRAJECTORY, "step_count")}
    if None in found.values():
        names = [str(name) for name in data.keys(True, True)]
        raise KeyError(
            f"frames must have {TRAJECTORY}, which TorchRL's collectors write, and "
            f"'step_count', which its StepCounter writes, got {names}"
        )
    trajectory, step = (
        entry.reshape(data.numel(), -1)[:, 0].cpu() for entry in found.values()
    )
    # In the order in which they begin in the storage: of several processes the number
    # of one says which was first to ask for it.
    _, number = trajectory.unique(return_inverse=True)
    row = torch.arange(len(number))
    trajectory = row.scatter_reduce(0, number, row, "amin", include_self=False)[number]
    by_step = step.argsort(stable=True)
    order = by_step[trajectory[by_step].argsort(stable=True)]
    trajectory, step = trajectory[order], step[order]
    same = trajectory[1:] == trajectory[:-1]
    gap = step[1:] - step[:-1]
    if bool((same & (gap == 0)).any()):
        raise ValueError(
            "trajectory numbers must be unique in the storage, got two frames of the "
            "same trajectory and step; continue their numbers in a new run"
        )
    start = F.pad(~(same & (gap == 1)), (1, 0), value=True).nonzero().squeeze(-1)
    length = torch.diff(start, append=torch.tensor([len(order)]))
    group_start = torch.searchsorted(trajectory, trajectory[start])
    group_end = torch.searchsorted(trajectory, trajectory[start], right=True)
    first_step, group_length = step[start], group_end - group_start
    return Episodes(order, start, length, first_step, group_start, group_length)
