"""`WaypointMemory`: what each env has seen in this episode, as waypoints."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded

from toponav import keys
from toponav.transforms.embed_views import Compare, Embed, ViewSimilarity
from toponav.transforms.specs import (
    EpisodeMemory,
    KeyedTransform,
    Keys,
    find_views,
    read_views,
    require_reset,
    restarting_rows,
)
from toponav.transforms.waypoint_slots import CountOn, WaypointSlots
from toponav.views import ChannelOrder, check_order

_OUT_KEYS = [keys.EMBEDDING, keys.WAYPOINT, keys.SIMILARITY, keys.NOVEL]
_OUT_KEYS += [keys.IS_NEW_WAYPOINT, keys.VISITS, keys.NUM_WAYPOINTS]
#: Decisions from one reading of numbers to the next where it waits for the device: as
#: many slots are compared as the fullest env had waypoints then.
_READ_EVERY = 16


class WaypointMemory(EpisodeMemory, KeyedTransform):
    """Maps each view to a waypoint of its episode, or makes it one.

    The first view of an episode is its first waypoint. A later view whose highest
    similarity to a waypoint exceeds ``threshold`` is mapped to it (ties: the lower
    index), whose visits go up by one. Any other view is *novel*, and becomes a
    waypoint, with one visit, if ``persistence``, ``min_gap`` and ``capacity`` allow it.
    The callables are neither moved nor saved with it and must be in ``eval()`` mode.

    Reference:
        The paper, "Formulate reward function", Fig. 5 and eq. 6.

    Args:
        embed: views ``[N, H, W, C]``, as they are, to embeddings ``[N, D]``.
        compare: ``[N, D]`` and memory ``[N, M, P]`` to similarities ``[N, M]``, 0 to 1.
        prepare: embeddings ``[N, M, D]`` to entries ``[N, M, P]``; by default the same.
        capacity: the most waypoints of an episode.
        threshold: in [0, 1); a view is mapped if its similarity is above it.
        persistence: for how many decisions in a row views must have been novel.
        min_gap: least number of decisions from one new waypoint to the next.
        count_on: ``"every"`` decision at a waypoint is a visit (the paper's), or only
            the ``"entry"``: the last mapped view was mapped to another one.
        keep_images: keep the view of each waypoint, for `refresh`.
        in_keys: key of the views, ``pixels`` unless given, see ``channels``.
        out_keys: keys of the embedding ``[*B, D]`` and of six entries ``[*B, 1]``.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, C, H, W]``.

    Examples:
        >>> def view(red):
        ...     return TensorDict({"pixels": torch.full((1, 1, 1, 1), red)}, [1])
        >>> memory = WaypointMemory(
        ...     embed=lambda views: views.flatten(1),
        ...     compare=lambda one, many: 1 - (one.unsqueeze(1) - many).abs().mean(-1),
        ... )
        >>> start = memory._reset(TensorDict(batch_size=[1]), view(0.0))
        >>> now = [memory._step(TensorDict(), view(red)) for red in (0.1, 0.8, 0.9)]
        >>> [data["waypoint"].item() for data in now]
        [0, 1, 1]
    """

    default_keys = [keys.PIXELS], _OUT_KEYS

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        *,
        prepare: Embed | None = None,
        capacity: int = 200,
        threshold: float = 0.5,
        persistence: int = 1,
        min_gap: int = 1,
        count_on: CountOn = "every",
        keep_images: bool = False,
        in_keys: Keys = None,
        out_keys: Keys = None,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__(in_keys, out_keys)
        self.channels = check_order(channels)
        self.similarity = ViewSimilarity(embed, compare, prepare)
        self._set_threshold(threshold)
        self.slots = WaypointSlots(
            capacity=capacity,
            persistence=persistence,
            min_gap=min_gap,
            count_on=count_on,
            keep_images=keep_images,
        )
        # Decisions since numbers were read.
        self._unread = 0

    def _set_threshold(self, threshold: float) -> None:
        if not 0 <= threshold < 1:
            raise ValueError(f"threshold must be in [0, 1), got {threshold}")
        self.threshold = float(threshold)

    def get_extra_state(self) -> dict[str, float]:
        return {"threshold": self.threshold}

    def set_extra_state(self, state: dict[str, float]) -> None:
        self.threshold = state["threshold"]

    @torch.no_grad()
    def refresh(self, threshold: float | None = None, *, chunk: int = 64) -> None:
        """Embed all waypoints again, ``chunk`` at a time, with new weights.

        ``threshold`` is the one that fits them; None keeps it. Needs ``keep_images``.
        """
        if not self.slots.keep_images:
            raise ValueError("keep_images must be True to refresh, got False")
        if threshold is not None:
            self._set_threshold(threshold)
        self.slots.read_num_used()
        envs, slot = self.slots.live.nonzero(as_tuple=True)
        if len(envs):
            for some, where in zip(envs.split(chunk), slot.split(chunk), strict=True):
                self._embed_into(some, where, self.slots.images[some, where])

    @torch.no_grad()
    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape, views = self._views(tensordict_reset)
        self.slots.resize(len(views), views.device)
        rows = restarting_rows(self, tensordict, shape, views.device).reshape(-1)
        envs = rows.nonzero().squeeze(-1)
        if len(envs):
            self.slots.restart(envs)
            first = self._embed_into(envs, torch.zeros_like(envs), views[envs])
        else:  # One view says how long an embedding is.
            first = self.similarity.embed(views[:1])[:0]
        embedding = first.new_zeros(len(views), first.shape[-1])
        embedding[envs] = first
        waypoint, visits = rows.long() - 1, rows.long()
        similarity = torch.zeros_like(rows, dtype=torch.float32)
        flags = [waypoint, similarity, rows, rows.clone(), visits]
        return self._write(tensordict_reset, shape, [embedding, *flags])

    @torch.no_grad()
    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        shape, views = self._views(next_tensordict)
        require_reset([len(self.slots.num_waypoints)], [len(views)])
        embedding = self.similarity.embed(views)
        memory = self.slots.memory[:, : self.slots.num_used]
        known = self.similarity.compare(embedding, memory)
        known = known.masked_fill(~self.slots.live, 0.0)
        similarity, nearest = known.max(-1)
        novel = similarity <= self.threshold
        waypoint, is_new, visits = self.slots.decide(novel, nearest)
        self._store_new(is_new, waypoint, embedding, views)
        self._unread += 1
        if self._is_free(views.device) or self._unread == _READ_EVERY:
            self._unread = 0
            self.similarity.check(embedding, known)
            self.slots.read_num_used()
        similarity = similarity.clamp(0.0, 1.0)
        flags = [waypoint, similarity, novel, is_new, visits]
        return self._write(next_tensordict, shape, [embedding, *flags])

    def _views(self, tensordict: TensorDictBase) -> tuple[torch.Size, Tensor]:
        views = read_views(tensordict, self.in_keys[0], self.channels)
        return views.shape[:-3], views.reshape(-1, *views.shape[-3:])

    def _embed_into(self, envs: Tensor, slot: Tensor, views: Tensor) -> Tensor:
        """Keep views in slots of the rows ``envs``; returns their embeddings."""
        embedding = self.similarity.embed(views)
        self.similarity.check(embedding)
        self.slots.store(envs, slot, self.similarity.entries(embedding), views)
        return embedding

    def _is_free(self, device: torch.device) -> bool:
        """Whether reading a number of the device waits for nothing."""
        return device.type == "cpu"

    def _store_new(
        self, is_new: Tensor, waypoint: Tensor, embedding: Tensor, views: Tensor
    ) -> None:
        if self._is_free(is_new.device):
            envs = is_new.nonzero().squeeze(-1)
            if len(envs):
                entry = self.similarity.entries(embedding[envs])
                self.slots.store(envs, waypoint[envs], entry, views[envs])
            return
        # How many there are is not read, so that nothing waits for the device.
        envs = torch.arange(len(is_new), device=is_new.device)
        entry = self.similarity.entries(embedding)
        self.slots.store(envs, waypoint.clamp(min=0), entry, views, only=is_new)

    def _write(
        self, tensordict: TensorDictBase, shape: torch.Size, entries: list[Tensor]
    ) -> TensorDictBase:
        entries = [*entries, self.slots.num_waypoints.clone()]
        for key, value in zip(self.out_keys, entries, strict=True):
            tensordict.set(key, value.reshape(*shape, -1))
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        view = find_views(observation_spec, self.in_keys[0], self.channels)
        batch, device = view.shape[:-3], view.device
        length = self.similarity.embedding_length(view)
        number = Unbounded((*batch, 1), device, torch.int64)
        flag = Binary(1, (*batch, 1), device, torch.bool)
        specs = [
            Unbounded((*batch, length), device, torch.float32),
            number,
            Bounded(0.0, 1.0, (*batch, 1), device, torch.float32),
            *(flag, flag, number, number),
        ]
        for key, spec in zip(self.out_keys, specs, strict=True):
            observation_spec[key] = spec.clone()
        return observation_spec
