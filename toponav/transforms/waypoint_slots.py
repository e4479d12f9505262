"""`WaypointSlots`: which waypoints each env has, and how often it visited them."""

from collections.abc import Mapping
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn

from toponav.transforms.episode_buffers import grow_slots, match_buffers

Replacement = Literal["none", "oldest", "least_visited"]
CountOn = Literal["every", "entry"]

_PER_ENV = ("num_waypoints", "births", "streak", "since_birth", "last_waypoint")
_PER_SLOT = ("counts", "birth_order")
#: More than the births of an episode: sorts by visits first, then by age.
_AGES = 2**32


class Decision(NamedTuple):
    """What one decision did to the waypoints of every env.

    Args:
        waypoint: int64 ``[N]``, -1 for a view mapped to none.
        born: bool ``[N]``.
        visits: int64 ``[N]``, 0 where the decision is no visit.
    """

    waypoint: Tensor
    born: Tensor
    visits: Tensor


class WaypointSlots(nn.Module):
    """The bookkeeping of `WaypointMemory`: slots, visits, births and their guards.

    Knows neither views nor networks; an entry of the memory is whatever `store` is
    given. All envs are one row of N. See `WaypointMemory` for the arguments.

    Args:
        capacity: the most waypoints of an episode.
        replacement: which one a birth replaces when all slots are taken.
        persistence: novel decisions in a row that make a birth.
        min_gap: least number of decisions from one birth to the next.
        count_on: what counts as a visit.
        keep_images: whether there is a buffer of images.

    Raises:
        ValueError: if an argument is out of range.

    Examples:
        >>> slots = WaypointSlots(capacity=8)
        >>> slots.follow(1, torch.device("cpu"))
        >>> slots.restart(torch.tensor([0]))
        >>> slots.decide(novel=torch.tensor([True]), nearest=torch.tensor([0]))
        Decision(waypoint=tensor([1]), born=tensor([True]), visits=tensor([1]))
        >>> slots.decide(novel=torch.tensor([False]), nearest=torch.tensor([1]))
        Decision(waypoint=tensor([1]), born=tensor([False]), visits=tensor([2]))

    Shape notation:
        N: number of envs.  A: slots there is room for.  L: slots in use somewhere.
    """

    memory: Tensor
    images: Tensor
    counts: Tensor
    birth_order: Tensor
    num_waypoints: Tensor
    births: Tensor
    streak: Tensor
    since_birth: Tensor
    last_waypoint: Tensor

    def __init__(
        self,
        *,
        capacity: int = 200,
        replacement: Replacement = "none",
        persistence: int = 1,
        min_gap: int = 1,
        count_on: CountOn = "every",
        keep_images: bool = False,
    ) -> None:
        super().__init__()
        _check_at_least_one(capacity=capacity, persistence=persistence, min_gap=min_gap)
        _check_choice("replacement", replacement, get_args(Replacement))
        _check_choice("count_on", count_on, get_args(CountOn))
        self.capacity = capacity
        self.replacement = replacement
        self.persistence = persistence
        self.min_gap = min_gap
        self.count_on = count_on
        self.keep_images = keep_images
        #: The most waypoints that any env may have: a number of the host's.
        self.fullest = 0
        self.register_buffer("memory", torch.empty(0, 0, 0))
        self.register_buffer("images", torch.empty(0, 0, dtype=torch.uint8))
        for name in _PER_SLOT:
            self.register_buffer(name, torch.empty(0, 0, dtype=torch.int64))
        for name in _PER_ENV:
            self.register_buffer(name, torch.empty(0, dtype=torch.int64))

    def _load_from_state_dict(
        self, state_dict: Mapping[str, object], prefix: str, *args: object
    ) -> None:
        match_buffers(self, state_dict, prefix)
        super()._load_from_state_dict(state_dict, prefix, *args)
        self.look()

    @property
    def live(self) -> Tensor:
        """Which of the slots in use hold a waypoint, bool ``[N, L]``."""
        slot = torch.arange(self.fullest, device=self.counts.device)
        return slot < self.num_waypoints.unsqueeze(-1)

    def follow(self, num_envs: int, device: torch.device) -> None:
        """Have one row per env, all empty if their number changed, on ``device``."""
        num_waypoints = self.num_waypoints
        if num_waypoints.device != device:
            self.to(device)
        if len(num_waypoints) != num_envs:
            for name, buffer in list(self.named_buffers()):
                shape = (num_envs, *buffer.shape[1:])
                setattr(self, name, buffer.new_zeros(shape))
            self.fullest = 0

    def look(self) -> None:
        """Take `fullest` from the counts, which waits for their device."""
        many = self.num_waypoints
        self.fullest = int(many.max()) if len(many) else 0

    def restart(self, envs: Tensor) -> None:
        """Begin an episode: one waypoint, just born and visited once.

        Args:
            envs: int64 ``[R]``, the rows that begin.
        """
        self._make_room(1)
        for name, start in (("since_birth", 0), ("streak", 0), ("last_waypoint", 0)):
            getattr(self, name)[envs] = start
        for name in ("num_waypoints", "births"):
            getattr(self, name)[envs] = 1
        self.counts[envs, 0] = 1
        self.birth_order[envs, 0] = 0
        self.fullest = max(self.fullest, 1)

    def decide(self, novel: Tensor, nearest: Tensor) -> Decision:
        """Count a visit or give birth, in every env.

        Args:
            novel: bool ``[N]``; the view is like no waypoint.
            nearest: int64 ``[N]``; slot of the nearest waypoint, if not novel.
        """
        self._make_room(min(self.fullest + 1, self.capacity))
        # Modules look attributes up slowly, and half of this is such overhead.
        num, last_waypoint = self.num_waypoints, self.last_waypoint
        mapped = ~novel
        full = num >= self.capacity
        born = self._birth(novel, full)
        visited = mapped
        if self.count_on == "entry":
            visited = mapped & (nearest != last_waypoint)
        mapped = mapped | born
        slot = torch.where(born, self._free_slot(full), nearest * mapped)
        count = self._mark(born, visited, slot)
        num += born & ~full
        torch.where(mapped, slot, last_waypoint, out=last_waypoint)
        self.fullest = min(self.fullest + 1, self.capacity)
        waypoint = torch.where(mapped, slot, -1)
        return Decision(waypoint, born, count * (born | visited))

    def _birth(self, novel: Tensor, full: Tensor) -> Tensor:
        """Which novel views become waypoints, bool ``[N]``."""
        streak, since_birth = self.streak, self.since_birth
        streak.add_(1).mul_(novel)
        since_birth.add_(1)
        born = novel & (streak >= self.persistence) & (since_birth >= self.min_gap)
        if self.replacement == "none":
            born = born & ~full
        others = ~born
        streak.mul_(others)
        since_birth.mul_(others)
        return born

    def _mark(self, born: Tensor, visited: Tensor, slot: Tensor) -> Tensor:
        """Count visits and note ages; return the visits of ``slot``, ``[N]``."""
        index, births = slot.unsqueeze(-1), self.births
        count = self.counts.gather(1, index).squeeze(-1) + visited
        count.masked_fill_(born, 1)
        self.counts.scatter_(1, index, count.unsqueeze(-1))
        if self.replacement != "none":
            order = self.birth_order.gather(1, index).squeeze(-1)
            order = torch.where(born, births, order)
            self.birth_order.scatter_(1, index, order.unsqueeze(-1))
        births += born
        return count

    def _free_slot(self, full: Tensor) -> Tensor:
        """Slot of a waypoint that would be born now, int64 ``[N]``."""
        if self.replacement == "none" or self.fullest < self.capacity:
            return self.num_waypoints
        rank = self.birth_order
        if self.replacement == "least_visited":
            rank = self.counts * _AGES + rank
        return torch.where(full, rank.argmin(-1), self.num_waypoints)

    def store(
        self,
        envs: Tensor,
        slot: Tensor,
        entry: Tensor,
        view: Tensor,
        *,
        only: Tensor | None = None,
    ) -> None:
        """Write the entries of waypoints that were born.

        Args:
            envs: int64 ``[R]``; their rows, each once.
            slot: int64 ``[R]``.
            entry: ``[R, P]``, for the memory.
            view: ``[R, H, W, C]``, kept if ``keep_images``.
            only: bool ``[R]``; leave the others' slots as they are.
        """
        self.memory = self._with(self.memory, envs, slot, entry, only)
        if self.keep_images:
            images = self.images.to(view.dtype)
            self.images = self._with(images, envs, slot, view, only)

    def _with(
        self,
        buffer: Tensor,
        envs: Tensor,
        slot: Tensor,
        values: Tensor,
        only: Tensor | None,
    ) -> Tensor:
        shape = (*self.counts.shape, *values.shape[1:])
        if buffer.shape != shape:
            buffer = buffer.new_zeros(shape)
        if only is not None:
            keep = ~only.reshape(-1, *[1] * (values.ndim - 1))
            values = torch.where(keep, buffer[envs, slot], values)
        buffer[envs, slot] = values.to(buffer.dtype)
        return buffer

    def _make_room(self, num_slots: int) -> None:
        """Double the slots until there are at least so many."""
        if self.counts.shape[1] >= num_slots:
            return
        names = [*_PER_SLOT, "memory", *(["images"] if self.keep_images else [])]
        for name in names:
            buffer = getattr(self, name)
            setattr(self, name, grow_slots(buffer, num_slots, self.capacity))


def _check_at_least_one(**arguments: int) -> None:
    for name, value in arguments.items():
        if value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name} must be one of {choices}, got {value!r}")
