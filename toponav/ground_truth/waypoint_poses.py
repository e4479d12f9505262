"""`WaypointPoses`: where a map's waypoints truly are, kept apart from the map."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav.keys import ENV_ID, HEADING, POSITION, read_entry

#: Observations of earlier batches that may still become waypoints: those for which a
#: map waits (``map.surroundings``), and, where it knows headings, those of an episode
#: until it has found its own.
_BACK = 8192


class WaypointPoses:
    """Records the poses of a map's waypoints from the batches that the map is fed.

    Examples:
        >>> batch = TensorDict({POSITION: [[[10.0, 20], [30, 40]]]}, [1, 2])
        >>> batch[HEADING] = torch.tensor([[[90.0], [180]]])
        >>> poses = WaypointPoses()
        >>> poses.remember(batch.set("env_id", torch.zeros(1, 2, 1).long()))
        >>> poses.extend(torch.tensor([[0, 1]]))
        >>> poses.values
        tensor([[ 30.,  40., 180.]])
    """

    def __init__(self, poses: Tensor | None = None) -> None:
        #: float32 ``[W, 3]``: x and y in map units, heading in degrees.
        self.values = torch.empty(0, 3) if poses is None else poses
        #: The last poses of each environment, and how many came before them.
        self.last: dict[int, tuple[int, Tensor]] = {}

    def remember(self, data: TensorDictBase) -> None:
        """Keep the poses of the batch ``[E, T]`` that the map is fed."""
        pose = [read_entry(data, key) for key in (POSITION, HEADING)]
        poses = torch.cat(pose, -1).float().cpu()
        envs = read_entry(data, ENV_ID)[:, 0].flatten().tolist()
        for env, new in zip(envs, poses, strict=True):
            begin, old = self.last.get(env, (0, torch.empty(0, 3)))
            begin += max(len(old) - _BACK, 0)
            self.last[env] = begin, torch.cat([old[-_BACK:], new])

    def extend(self, origins: Tensor) -> None:
        """Look up the poses of new waypoints by the origins ``[W, 2]`` of all."""
        new = []
        for env, number in origins[len(self.values) :].tolist():
            begin, poses = self.last[env]
            if not begin <= number < begin + len(poses):
                raise KeyError(f"observation {number} of environment {env}")
            new.append(poses[number - begin])
        if new:
            self.values = torch.cat([self.values, torch.stack(new)])

    def merge(self, numbers: Tensor) -> None:
        """Keep the first pose of those that became one, by their new numbers."""
        num_kept = int(numbers.max()) + 1 if len(numbers) else 0
        first = torch.full((num_kept,), len(numbers))
        first.scatter_reduce_(0, numbers, torch.arange(len(numbers)), "amin")
        self.values = self.values[first]

    def keep(self, kept: Tensor) -> None:
        """Forget all but those of the waypoints ``kept``, int64 ``[W']``."""
        self.values = self.values[kept]
