"""`WaypointSlots`: which waypoints each env has, and how often it visited them."""

from typing import Literal, get_args

import torch
from torch import Tensor, nn

from toponav.transforms.specs import ResizableBuffers, grow_slots

CountOn = Literal["every", "entry"]

_SINCE_START = ("novel_streak", "since_new", "last_waypoint")


class WaypointSlots(ResizableBuffers, nn.Module):
    """The bookkeeping of `WaypointMemory`: slots, visits and guards of new waypoints.

    All envs are one batch of N; each has A slots, of which L are in use somewhere.
    """

    memory: Tensor
    images: Tensor
    counts: Tensor
    num_waypoints: Tensor
    novel_streak: Tensor
    since_new: Tensor
    last_waypoint: Tensor

    def __init__(
        self,
        *,
        capacity: int,
        persistence: int,
        min_gap: int,
        count_on: CountOn,
        keep_images: bool,
    ) -> None:
        super().__init__()
        minima = {"capacity": capacity, "persistence": persistence, "min_gap": min_gap}
        for name, value in minima.items():
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")
        if count_on not in (choices := get_args(CountOn)):
            raise ValueError(f"count_on must be one of {choices}, got {count_on!r}")
        self.capacity = capacity
        self.persistence = persistence
        self.min_gap = min_gap
        self.count_on = count_on
        self.keep_images = keep_images
        #: L, or more: how many waypoints an env may have at most, known to the host.
        self.num_used = 0
        self.register_buffer("memory", torch.empty(0, 0, 0))
        self.register_buffer("images", torch.empty(0, 0, dtype=torch.uint8))
        self.register_buffer("counts", torch.empty(0, 0, dtype=torch.int64))
        for name in ("num_waypoints", *_SINCE_START):
            self.register_buffer(name, torch.empty(0, dtype=torch.int64))

    def get_extra_state(self) -> int:
        return self.num_used

    def set_extra_state(self, state: int) -> None:
        self.num_used = state

    @property
    def live(self) -> Tensor:
        """Which of the slots in use hold a waypoint, bool ``[N, L]``."""
        slot = torch.arange(self.num_used, device=self.counts.device)
        return slot < self.num_waypoints.unsqueeze(-1)

    def resize(self, num_envs: int, device: torch.device) -> None:
        """Have one row per env, all empty if their number changed, on ``device``."""
        self.to(device)
        if len(self.num_waypoints) != num_envs:
            for name, buffer in list(self.named_buffers()):
                setattr(self, name, buffer.new_zeros(num_envs, *buffer.shape[1:]))
            self.num_used = 0

    def read_num_used(self) -> None:
        """Read `num_used` from the counts, which waits for their device."""
        self.num_used = max(self.num_waypoints.tolist(), default=0)

    def restart(self, envs: Tensor) -> None:
        """Begin an episode in rows ``envs``, int64 ``[R]``, with one waypoint."""
        self._make_room(1)
        for name in _SINCE_START:
            getattr(self, name)[envs] = 0
        self.num_waypoints[envs] = 1
        self.counts[envs, 0] = 1
        self.num_used = max(self.num_used, 1)

    def decide(self, novel: Tensor, nearest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Count a visit of slot ``nearest``, or of a new waypoint if ``novel``.

        ``waypoint``, ``is_new_waypoint`` and ``visits`` as in the keys, ``[N]``.
        """
        self._make_room(min(self.num_used + 1, self.capacity))
        # Modules look attributes up slowly, and half of this is such overhead.
        num, last_waypoint, counts = self.num_waypoints, self.last_waypoint, self.counts
        novel_streak, since_new = self.novel_streak, self.since_new
        novel_streak.add_(1).mul_(novel)
        since_new.add_(1)
        is_new = novel & (novel_streak >= self.persistence)
        is_new &= (since_new >= self.min_gap) & (num < self.capacity)
        novel_streak.mul_(~is_new)
        since_new.mul_(~is_new)
        visited = mapped = ~novel
        if self.count_on == "entry":
            visited = mapped & (nearest != last_waypoint)
        slot = torch.where(is_new, num, nearest * mapped)
        mapped = mapped | is_new
        index = slot.unsqueeze(-1)
        count = counts.gather(1, index).squeeze(-1) + visited
        count.masked_fill_(is_new, 1)
        counts.scatter_(1, index, count.unsqueeze(-1))
        num += is_new
        torch.where(mapped, slot, last_waypoint, out=last_waypoint)
        self.num_used = min(self.num_used + 1, self.capacity)
        return torch.where(mapped, slot, -1), is_new, count * (is_new | visited)

    def store(
        self,
        envs: Tensor,
        slot: Tensor,
        entry: Tensor,
        view: Tensor,
        *,
        only: Tensor | None = None,
    ) -> None:
        """Write entries ``[R, P]`` and views of rows ``envs [R]``, ``only`` of some."""
        kept = {"memory": entry.float()}
        if self.keep_images:
            kept["images"] = view
        for name, values in kept.items():
            buffer = getattr(self, name).to(values.dtype)
            shape = (*self.counts.shape, *values.shape[1:])
            if buffer.shape != shape:
                buffer = buffer.new_zeros(shape)
            if only is not None:
                chosen = only.reshape(-1, *[1] * (values.ndim - 1))
                values = torch.where(chosen, values, buffer[envs, slot])
            buffer[envs, slot] = values
            setattr(self, name, buffer)

    def _make_room(self, num_slots: int) -> None:
        if self.counts.shape[1] >= num_slots:
            return
        for name in ["counts", "memory", *(["images"] if self.keep_images else [])]:
            larger = grow_slots(getattr(self, name), num_slots, self.capacity)
            setattr(self, name, larger)
