"""`WaypointTruth`: which new waypoints are of a place that has one already."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite

from toponav.keys import HEADING, IS_NEW_WAYPOINT, POSITION, SPURIOUS_WAYPOINT
from toponav.transforms.specs import (
    KeyedTransform,
    Keys,
    ResizableBuffers,
    find_spec,
    grow_slots,
    restarting_rows,
)


class WaypointTruth(ResizableBuffers, KeyedTransform):
    """Marks *spurious* waypoints: an earlier one of the episode is near, heading alike.

    The similarity has failed to recognise the place. It reads privileged keys and is
    for evaluation.

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

    default_keys = [POSITION, HEADING, IS_NEW_WAYPOINT], [SPURIOUS_WAYPOINT]
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
        super().__init__(in_keys, out_keys)
        self.distance = distance
        self.angle = angle
        # x, y and heading of each waypoint, [N, A, 3], and their number, [N].
        self.register_buffer("poses", torch.empty(0, 0, 3))
        self.register_buffer("num_waypoints", torch.empty(0, dtype=torch.int64))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        is_new = tensordict_reset[self.in_keys[2]]
        self.to(is_new.device)
        rows = restarting_rows(self, tensordict, is_new.shape[:-1], is_new.device)
        rows = rows.reshape(-1)
        if len(self.num_waypoints) != len(rows):
            self.poses = self.poses.new_zeros(len(rows), self.poses.shape[1], 3)
            self.num_waypoints = self.num_waypoints.new_zeros(len(rows))
        self.num_waypoints = self.num_waypoints * ~rows
        return self._judge(tensordict_reset, rows)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._judge(next_tensordict)

    def _judge(
        self, tensordict: TensorDictBase, rows: Tensor | bool = True
    ) -> TensorDictBase:
        position, heading, flag = (tensordict[key] for key in self.in_keys)
        pose = torch.cat([position, heading], -1).reshape(-1, 3)
        is_new = flag.reshape(-1) & rows
        num_used = max(self.num_waypoints.tolist())
        earlier = self.poses[:, :num_used]
        slot = torch.arange(num_used, device=pose.device)
        apart = earlier - pose.unsqueeze(1)
        near = apart[..., :2].norm(dim=-1) <= self.distance
        turned = ((apart[..., 2] + 180) % 360 - 180).abs() <= self.angle
        known = near & turned & (slot < self.num_waypoints.unsqueeze(-1))
        spurious = is_new & known.any(-1)
        self.poses = grow_slots(self.poses, num_used + 1)
        place = (torch.arange(len(pose), device=pose.device), self.num_waypoints)
        self.poses[place] = torch.where(is_new.unsqueeze(-1), pose, self.poses[place])
        self.num_waypoints = self.num_waypoints + is_new
        return tensordict.set(self.out_keys[0], spurious.reshape(flag.shape))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, length in zip(self.in_keys, (2, 1, 1), strict=True):
            flag = find_spec(observation_spec, key, length=length)
        spec = Binary(1, flag.shape, flag.device, torch.bool)
        return observation_spec.set(self.out_keys[0], spec)
