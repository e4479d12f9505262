"""`WaypointPoses`: where a map's waypoints truly are, kept apart from the map."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav.keys import ENV_ID, HEADING, POSITION

#: Observations of earlier batches that may still become waypoints.
_BACK = 64


class WaypointPoses:
    """Follows the batches that a map is fed and notes the poses of its waypoints.

    A map says of each waypoint which observation of which environment it was; this
    says where the agent then stood. It is for evaluation: neither the map nor an agent
    reads it.

    Args:
        poses: those of an earlier part of the run, ``[W, 3]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> place = {"position": torch.tensor([[[10.0, 20.0], [30.0, 40.0]]])}
        >>> place["heading"] = torch.tensor([[[90.0], [180.0]]])
        >>> env = torch.zeros(1, 2, 1, dtype=torch.int64)
        >>> poses = WaypointPoses()
        >>> poses.remember(TensorDict({"privileged": place, "env_id": env}, [1, 2]))
        >>> poses.note(torch.tensor([[0, 1]]))
        >>> poses.values
        tensor([[ 30.,  40., 180.]])

    Shape notation:
        W: waypoints.  E: environments.  T: time.
    """

    def __init__(self, poses: Tensor | None = None) -> None:
        #: float32 ``[W, 3]``: x and y in map units, heading in degrees.
        self.values = torch.empty(0, 3) if poses is None else poses
        # What each environment saw last, and how much it had seen before that.
        self._last: dict[int, tuple[int, Tensor]] = {}

    def remember(self, data: TensorDictBase) -> None:
        """Note where the agents stood.

        Args:
            data: the batch ``[E, T]`` that the map is fed, with the truth.
        """
        poses = torch.cat([data.get(POSITION), data.get(HEADING)], -1).float().cpu()
        envs = data.get(ENV_ID)[:, 0].flatten().tolist()
        for env, new in zip(envs, poses, strict=True):
            begin, old = self._last.get(env, (0, torch.empty(0, 3)))
            begin += max(len(old) - _BACK, 0)
            self._last[env] = begin, torch.cat([old[-_BACK:], new])

    def note(self, origins: Tensor) -> None:
        """Note the poses of waypoints that the map does not have yet.

        Args:
            origins: int64 ``[W, 2]``, of all waypoints, see `TopologicalMap`; those
                after the ones that are known are looked up.

        Raises:
            KeyError: if an observation was not remembered.
        """
        new = []
        for env, number in origins[len(self.values) :].tolist():
            begin, poses = self._last[env]
            if not begin <= number < begin + len(poses):
                raise KeyError(f"observation {number} of environment {env}")
            new.append(poses[number - begin])
        if new:
            self.values = torch.cat([self.values, torch.stack(new)])

    def merge(self, numbers: Tensor) -> None:
        """Follow a merge: the first of those that became one is where they are.

        Args:
            numbers: int64 ``[W]``, the new number of each waypoint.
        """
        first = torch.full((int(numbers.max()) + 1,), len(numbers))
        first.scatter_reduce_(0, numbers, torch.arange(len(numbers)), "amin")
        self.values = self.values[first]
