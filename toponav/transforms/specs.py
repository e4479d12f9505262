"""What transforms share: keys, specs, views, generators and buffers of episodes."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, Self

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Composite, TensorSpec
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import (
    AutoResetTransform,
    Transform,
    VecGymEnvTransform,
)

from toponav.keys import WRITERS, read_entry
from toponav.parts import needs_env
from toponav.views import ChannelOrder, check_order, check_views

#: Keys as callers give them: ``None`` for the defaults.
Keys = Sequence[NestedKey] | None


class KeyedTransform(Transform):
    """A transform with default keys, of which others must be as many."""

    default_keys: tuple[Sequence[NestedKey], Sequence[NestedKey]]

    def __init__(self, in_keys: Keys = None, out_keys: Keys = None) -> None:
        default_in, default_out = self.default_keys
        super().__init__(in_keys or default_in, out_keys or default_out)
        num_in, num_out = len(default_in), len(default_out)
        if len(self.in_keys) != num_in or len(self.out_keys) != num_out:
            raise ValueError(
                f"in_keys must be {num_in} and out_keys {num_out}, "
                f"got {self.in_keys} and {self.out_keys}"
            )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise needs_env(self)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Unlike in a reset, nobody merges what begins and what goes on.
        begun = self._reset(tensordict, tensordict_reset.copy())
        begun, goes_on = (
            data.select(*self.out_keys, strict=False)
            for data in (begun, tensordict_reset)
        )
        shape, device = begun.batch_size, begun.device or torch.device("cpu")
        rows = restarting_rows(self, tensordict, shape, device)
        return tensordict_reset.update(begun.where(rows, goes_on))


class ViewTransform(Transform):
    """Reads views, their channels first or last, and writes something for each."""

    _spec_of: Callable[[NestedKey, TensorSpec], TensorSpec]

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        out_keys: Sequence[NestedKey],
        *,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__(in_keys, out_keys)
        self.channels = check_order(channels)
        if len(in_keys) != len(out_keys):
            raise ValueError(f"out_keys must match {self.in_keys}, got {self.out_keys}")

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            made = self._apply_transform(read_entry(next_tensordict, in_key))
            next_tensordict.set(out_key, made)
        return next_tensordict

    @dispatch(source="in_keys", dest="out_keys")  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            view = find_views(observation_spec, in_key, self.channels)
            observation_spec[out_key] = self._spec_of(in_key, view)
        return observation_spec


class SeededMixin:
    """Mixin of transforms that draw: a generator of their own, on the CPU."""

    def set_seed(self, seed: int | None) -> None:
        """Restart the generator; ``None`` takes a seed from the operating system."""
        self.generator = torch.Generator()
        self.generator.manual_seed(self.generator.seed() if seed is None else seed)

    def clone(self) -> Self:
        copied: Self = super().clone()  # type: ignore[misc]
        copied.generator = self.generator.clone_state()
        return copied

    def get_extra_state(self) -> Tensor:
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        self.generator.set_state(state.cpu())


def find_spec(
    specs: Composite,
    key: NestedKey,
    *,
    length: int | None = None,
    kind: str = "an observation",
) -> TensorSpec:
    """The spec of an entry; ValueError if it is missing or of another length."""
    names = list(specs.keys(True, True))
    if key not in names:
        hint = f" (add {WRITERS[key]})" if key in WRITERS else ""
        raise ValueError(f"{key!r} must be {kind} of the env{hint}, got {names}")
    spec = specs[key]
    if length is not None and spec.shape[-1:] != (length,):
        raise ValueError(f"{key!r} must be [*B, {length}], got {list(spec.shape)}")
    return spec


def find_views(specs: Composite, key: NestedKey, channels: ChannelOrder) -> TensorSpec:
    """The spec of views in an order; ValueError if they are something else."""
    spec = find_spec(specs, key)
    check_views(repr(key), spec.shape, channels)
    return spec


def read_views(
    tensordict: TensorDictBase, key: NestedKey, channels: ChannelOrder
) -> Tensor:
    """Views in an order; KeyError or ValueError for anything else."""
    views = read_entry(tensordict, key)
    check_views(repr(key), views.shape, channels)
    return views


class ResizableBuffers:
    """Mixin of modules whose buffers take shape and dtype of the state they load."""

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any
    ) -> None:
        module: Any = self
        for name, buffer in list(module.named_buffers(recurse=False)):
            stored = state_dict.get(prefix + name)
            if isinstance(stored, Tensor):
                setattr(self, name, torch.empty_like(stored, device=buffer.device))
        super()._load_from_state_dict(state_dict, prefix, *args)  # type: ignore[misc]


class SeesLastViews:
    """Mixin of transforms that read what an episode ends with: some envs lose it.

    They begin the next episode in the same step, and hand over zeros, or something of
    the new episode, as the end of the last one.
    """

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        self.require_last_views()
        return super().transform_output_spec(output_spec)  # type: ignore[misc]

    def require_last_views(self) -> None:
        """ValueError if the env loses what its episodes end with."""
        transform: Any = self
        try:
            env = transform.container
        except ValueError:  # it is in a `Compose` that is in no env
            return
        if lost := _lost_ends(env):
            raise self._refusal(*lost)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        raise self._refusal("native_autoreset must be False", "True")

    def _refusal(self, rule: str, got: str) -> ValueError:
        who = f"{type(self).__name__}, which must see how episodes end"
        return ValueError(f"{rule} for {who}, got {got}")


def _lost_ends(env: EnvBase | None) -> tuple[str, str] | None:
    """What must be set for an env to show how episodes end, and what is; or None."""
    while isinstance(env, TransformedEnv):
        transforms, env = env.transform.modules(), env.base_env
        for part in transforms:
            if isinstance(part, AutoResetTransform):
                return "auto_reset must be False", "True"
            if isinstance(part, VecGymEnvTransform) and not part.native_autoreset:
                mode = getattr(getattr(env, "autoreset_mode", None), "name", "None")
                if mode != "SAME_STEP" or not _finds_last_view(env):
                    return "autoreset_mode must be DISABLED", mode
    return None


def _finds_last_view(env: EnvBase) -> bool:
    """Whether TorchRL finds what a vector env observes at the end of an episode.

    It does if that is the only observation, and if TorchRL calls it ``observation``.
    """
    several = isinstance(env.single_observation_space, Mapping)
    return "observation" in list(env.observation_spec) and not several


class EpisodeMemory(SeesLastViews, ResizableBuffers):
    """Mixin of transforms that remember of each episode what they have seen of it."""

    def clone(self) -> Self:
        copied: Self = super().clone()  # type: ignore[misc]
        # TorchRL's clones share their buffers, but no two envs share an episode.
        for name in ("_buffers", "_modules"):
            setattr(copied, name, deepcopy(getattr(self, name)))
        return copied


class GrowingSlots(EpisodeMemory):
    """Mixin of transforms that keep ever more of each episode."""

    # Decisions for which there is room, whatever happens in them.
    _spare = 0

    def _make_room(self, name: str, used: Tensor) -> None:
        """Let the buffer ``[N, A, ...]`` have a free slot wherever ``used [N]`` are.

        They are counted on the host only when a row may be full: that waits for a GPU.
        """
        if self._spare == 0:
            most = max(used.tolist(), default=0)
            larger = grow_slots(getattr(self, name), most + 1)
            setattr(self, name, larger)
            self._spare = larger.shape[1] - most
        self._spare -= 1

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any
    ) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._spare = 0


def require_reset(known: Sequence[int], given: Sequence[int]) -> None:
    """Refuse a step of other envs than those of the last reset, or before any."""
    if tuple(known) != tuple(given):
        rule = f"a step must follow a reset of the same envs, {list(given)}"
        raise ValueError(f"{rule}, got one of {list(known)}")


def move_to(transform: Transform, device: torch.device) -> None:
    """Move a transform whose buffers are elsewhere.

    ``Transform.to`` also forgets the env that it is in, all of whose specs are computed
    again when it is next asked for: not to be done at every reset.
    """
    if any(buffer.device != device for buffer in transform.buffers()):
        transform.to(device)


def restarting_rows(
    transform: Transform,
    tensordict: TensorDictBase,
    shape: torch.Size,
    device: torch.device,
) -> Tensor:
    """Which envs begin a new episode in this reset, bool ``[*B]``: all if unmasked."""
    keys = ["_reset"] if transform.parent is None else transform.parent.reset_keys
    masks = [tensordict.get(key, None) for key in keys]
    rows = [mask.reshape(*shape, -1).any(-1) for mask in masks if mask is not None]
    if not rows:
        return torch.ones(shape, dtype=torch.bool, device=device)
    return torch.stack(rows).any(0).to(device)


def grow_slots(buffer: Tensor, num_slots: int, capacity: int | None = None) -> Tensor:
    """``buffer [N, A, ...]`` with room for ``num_slots`` per env, at least doubled."""
    slots = buffer.shape[1]
    if num_slots <= slots:
        return buffer
    room = max(num_slots, 2 * slots, 8)
    room = room if capacity is None else min(room, capacity)
    return F.pad(buffer, [0, 0] * (buffer.ndim - 2) + [0, room - slots])
