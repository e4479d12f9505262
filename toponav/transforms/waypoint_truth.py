"""`WaypointTruth`: tells births of true waypoints from false ones."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite
from torchrl.envs.transforms import Transform

from toponav.keys import BORN, FALSE_BIRTH, HEADING, POSITION
from toponav.transforms.episode_buffers import grow_slots, match_buffers, reset_rows


class WaypointTruth(Transform):
    """Marks births of waypoints where one of this episode was born already.

    A birth is *false* if an earlier one lies near and looked the same way: the
    similarity has failed to recognise the place. An agent that is paid for births can
    live on false ones, which shows here first. All births of the episode count, also
    those that a full memory has replaced. It reads privileged keys and is for
    evaluation: no agent sees it.

    Args:
        distance: in map units, how near is near; that far still is.
        angle: in degrees, how different a heading is the same way; so far still is.
        in_keys: keys of the position, float32 ``[*B, 2]``, the heading in degrees,
            float32 ``[*B, 1]``, and of what is born, bool ``[*B, 1]``.
        out_keys: key of the false births, bool ``[*B, 1]``.

    Raises:
        ValueError: if an argument is out of range, and when the env's specs are read,
            if a key is missing or has another shape.

    Examples:
        The second birth is 50 units from the first, but looks back:

        >>> from tensordict import TensorDict
        >>> def birth(x, heading):
        ...     pose = {"position": torch.tensor([x, 0.0])}
        ...     pose["heading"] = torch.tensor([heading])
        ...     return TensorDict({"privileged": pose, "born": torch.tensor([True])})
        >>> truth = WaypointTruth()
        >>> start = truth._reset(TensorDict(), birth(0.0, 350.0))
        >>> [
        ...     truth._step(TensorDict(), birth(x, heading))[FALSE_BIRTH].item()
        ...     for x, heading in ((50.0, 180.0), (96.0, 35.0), (200.0, 35.0))
        ... ]
        [False, True, False]

    Shape notation:
        B: batch of environments.
    """

    poses: Tensor
    births: Tensor

    def __init__(
        self,
        distance: float = 96.0,
        angle: float = 45.0,
        *,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if not distance >= 0:
            raise ValueError(f"distance must be at least 0 map units, got {distance}")
        if not 0 <= angle <= 180:
            raise ValueError(f"angle must be in [0, 180] degrees, got {angle}")
        super().__init__(
            in_keys=[POSITION, HEADING, BORN] if in_keys is None else in_keys,
            out_keys=[FALSE_BIRTH] if out_keys is None else out_keys,
        )
        if len(self.in_keys) != 3 or len(self.out_keys) != 1:
            raise ValueError(
                "in_keys must be three keys and out_keys one, "
                f"got {self.in_keys} and {self.out_keys}"
            )
        self.distance = distance
        self.angle = angle
        # x, y and heading of each birth, [N, A, 3], and their number, [N].
        self.register_buffer("poses", torch.empty(0, 0, 3))
        self.register_buffer("births", torch.empty(0, dtype=torch.int64))
        # The most births that any env may have had: a number of the host's.
        self._most = 0

    def _load_from_state_dict(
        self, state_dict: Mapping[str, object], prefix: str, *args: object
    ) -> None:
        match_buffers(self, state_dict, prefix)
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._most = self.poses.shape[1]

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        pose, born = self._read(tensordict_reset)
        shape = tensordict_reset.get(self.in_keys[2]).shape[:-1]
        reset_keys = ["_reset"] if self.parent is None else self.parent.reset_keys
        rows = reset_rows(tensordict, reset_keys, shape).to(pose.device).reshape(-1)
        self.births = self.births * ~rows
        return self._judge(tensordict_reset, pose, born & rows)

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        return self._judge(next_tensordict, *self._read(next_tensordict))

    def _read(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return poses, ``[N, 3]``, and births, ``[N]``; one row per env."""
        position, heading, born = (tensordict.get(key) for key in self.in_keys)
        pose = torch.cat([position, heading], -1).reshape(-1, 3)
        if self.poses.device != pose.device:
            self.to(pose.device)
        if len(self.births) != len(pose):
            self.poses = pose.new_zeros(len(pose), self.poses.shape[1], 3)
            self.births = torch.zeros_like(pose[:, 0], dtype=torch.int64)
        return pose, born.reshape(-1)

    def _judge(
        self, tensordict: TensorDictBase, pose: Tensor, born: Tensor
    ) -> TensorDictBase:
        # On the CPU the number of births is looked up; elsewhere, where that would
        # wait for the device, each decision is taken to be one.
        on_cpu = pose.device.type == "cpu"
        self._most = int(self.births.max()) if on_cpu else self._most
        earlier = self.poses[:, : self._most]
        slot = torch.arange(earlier.shape[1], device=pose.device)
        apart = earlier - pose.unsqueeze(1)
        near = apart[..., :2].norm(dim=-1) <= self.distance
        turned = ((apart[..., 2] + 180) % 360 - 180).abs() <= self.angle
        known = near & turned & (slot < self.births.unsqueeze(-1))
        false = born & known.any(-1)
        self._most += 1
        self.poses = grow_slots(self.poses, self._most)
        row = torch.arange(len(pose), device=pose.device)
        place = (row, self.births)
        self.poses[place] = torch.where(born.unsqueeze(-1), pose, self.poses[place])
        self.births = self.births + born
        shape = tensordict.get(self.in_keys[2]).shape
        return tensordict.set(self.out_keys[0], false.reshape(shape))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, length in zip(self.in_keys, (2, 1, 1), strict=True):
            if key not in observation_spec.keys(True, True):
                raise ValueError(f"{key!r} must be an observation of the env, got none")
            if observation_spec[key].shape[-1:] != (length,):
                raise ValueError(
                    f"{key!r} must be [*B, {length}], got {observation_spec[key].shape}"
                )
        born = observation_spec[self.in_keys[2]]
        observation_spec[self.out_keys[0]] = Binary(
            1, shape=born.shape, dtype=torch.bool, device=born.device
        )
        return observation_spec
