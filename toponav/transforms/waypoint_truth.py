"""`WaypointTruth`: which new waypoints are of a place that has one already."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite

from toponav.keys import HEADING, IS_NEW_WAYPOINT, POSITION, SPURIOUS_WAYPOINT
from toponav.transforms.episode_buffers import (
    ReadSchedule,
    ResizableBuffers,
    grow_slots,
    restarting_rows,
)
from toponav.transforms.specs import KeyedTransform, Keys, find_spec, get_entry


class WaypointTruth(ResizableBuffers, KeyedTransform):
    """Marks *spurious* waypoints: an earlier one of the episode is near, heading alike.

    There the similarity has failed to recognise the place. It reads privileged keys and
    is for evaluation: no agent sees it.

    Args:
        distance: how far away, in map units, still is near.
        angle: how many degrees of difference still are alike, in [0, 180].
        in_keys: keys of the position, float32 ``[*B, 2]``, the heading in degrees,
            float32 ``[*B, 1]``, and of new waypoints, bool ``[*B, 1]``.
        out_keys: key of the spurious ones, bool ``[*B, 1]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> def at(x, heading):
        ...     pose = {"position": torch.tensor([x, 0.0])}
        ...     pose["heading"] = torch.tensor([heading])
        ...     is_new = torch.tensor([True])
        ...     return TensorDict({"privileged": pose, "is_new_waypoint": is_new})
        >>> truth = WaypointTruth(distance=96)
        >>> start = truth._reset(TensorDict(), at(0.0, 350.0))
        >>> truth._step(TensorDict(), at(96.0, 35.0))[SPURIOUS_WAYPOINT].item()
        True
    """

    poses: Tensor
    num_waypoints: Tensor

    def __init__(
        self,
        distance: float,
        angle: float = 45.0,
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        if not distance >= 0:
            raise ValueError(f"distance must be at least 0 map units, got {distance}")
        if not 0 <= angle <= 180:
            raise ValueError(f"angle must be in [0, 180] degrees, got {angle}")
        defaults = [POSITION, HEADING, IS_NEW_WAYPOINT], [SPURIOUS_WAYPOINT]
        super().__init__(in_keys, out_keys, defaults=defaults)
        self.distance = distance
        self.angle = angle
        # x, y and heading of each waypoint, [N, A, 3], and their number, [N].
        self.register_buffer("poses", torch.empty(0, 0, 3))
        self.register_buffer("num_waypoints", torch.empty(0, dtype=torch.int64))
        # How many waypoints an env may have at most: a number of the host's.
        self._num_used = 0
        self.reads = ReadSchedule()

    def _load_from_state_dict(self, *args: Any) -> None:
        super()._load_from_state_dict(*args)
        self._num_used = self.poses.shape[1]

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        pose, is_new = self._read(tensordict_reset)
        shape = tensordict_reset.get(self.in_keys[2]).shape[:-1]
        rows = restarting_rows(self, tensordict, shape, pose.device).reshape(-1)
        self.num_waypoints = self.num_waypoints * ~rows
        return self._judge(tensordict_reset, pose, is_new & rows)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        return self._judge(next_tensordict, *self._read(next_tensordict))

    def _read(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        position, heading, is_new = (
            get_entry(self, tensordict, key) for key in self.in_keys
        )
        pose = torch.cat([position, heading], -1).reshape(-1, 3)
        if self.poses.device != pose.device:
            self.to(pose.device)
        if len(self.num_waypoints) != len(pose):
            self.poses = pose.new_zeros(len(pose), self.poses.shape[1], 3)
            self.num_waypoints = torch.zeros_like(pose[:, 0], dtype=torch.int64)
        return pose, is_new.reshape(-1)

    def _judge(
        self, tensordict: TensorDictBase, pose: Tensor, is_new: Tensor
    ) -> TensorDictBase:
        # Between two readings, each decision is taken to add a waypoint.
        if self.reads.is_due(pose.device):
            self._num_used = int(self.num_waypoints.max())
        earlier = self.poses[:, : self._num_used]
        slot = torch.arange(earlier.shape[1], device=pose.device)
        apart = earlier - pose.unsqueeze(1)
        near = apart[..., :2].norm(dim=-1) <= self.distance
        turned = ((apart[..., 2] + 180) % 360 - 180).abs() <= self.angle
        known = near & turned & (slot < self.num_waypoints.unsqueeze(-1))
        spurious = is_new & known.any(-1)
        self._num_used += 1
        self.poses = grow_slots(self.poses, self._num_used)
        row = torch.arange(len(pose), device=pose.device)
        place = (row, self.num_waypoints)
        self.poses[place] = torch.where(is_new.unsqueeze(-1), pose, self.poses[place])
        self.num_waypoints = self.num_waypoints + is_new
        shape = tensordict.get(self.in_keys[2]).shape
        return tensordict.set(self.out_keys[0], spurious.reshape(shape))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, length in zip(self.in_keys, (2, 1, 1), strict=True):
            is_new = find_spec(observation_spec, key, length=length)
        observation_spec[self.out_keys[0]] = Binary(
            1, shape=is_new.shape, dtype=torch.bool, device=is_new.device
        )
        return observation_spec
