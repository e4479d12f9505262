"""`WaypointMemory`: what each env has seen in this episode, as waypoints."""

from collections.abc import Sequence
from copy import deepcopy
from typing import Self

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs.transforms import Transform

from toponav.keys import (
    BORN,
    EMBEDDING,
    NOVEL,
    NUM_WAYPOINTS,
    PIXELS,
    SIMILARITY,
    VISITS,
    WAYPOINT,
)
from toponav.transforms.episode_buffers import reset_rows
from toponav.transforms.novelty import Aggregate, aggregate_similarity, check_aggregate
from toponav.transforms.view_similarity import Compare, Embed, ViewSimilarity
from toponav.transforms.waypoint_slots import CountOn, Replacement, WaypointSlots

_OUT_KEYS = [EMBEDDING, WAYPOINT, SIMILARITY, NOVEL, BORN, VISITS, NUM_WAYPOINTS]
#: Decisions between two looks at the numbers of another device than the CPU.
_LOOK_EVERY = 16


class WaypointMemory(Transform):
    """Maps each view to a waypoint of its episode, or makes it one.

    The first view of an episode is its first waypoint. In each decision after it,
    per env:

    1. the view is embedded and compared with all waypoints;
    2. if the similarity exceeds ``threshold``, the view is mapped to its nearest
       waypoint (ties: the lower index), whose visits go up by one; if not, it is
       *novel*;
    3. a novel view is *born* as a waypoint, with one visit, if ``persistence``,
       ``min_gap`` and ``capacity`` allow it.

    It writes no reward. `CountReward` pays for mapped views and
    `TemporalDistanceReward` for births: not for views that are novel and not born,
    since an agent could dwell on those for ever, while each birth makes its own view
    known. Without guards the two are the same.

    Useful alone, in any TorchRL project with views and a similarity in [0, 1]. The
    networks are handed in as callables and stay their owner's: they are neither moved
    nor saved with the transform, get no gradient, and must be in ``eval()`` mode. All
    envs are one row for them, ``N = prod(B)``.

    The memory of the current episodes is in ``state_dict()``, so that a resumed run
    goes on where it was. Comparisons are made with as many slots as the fullest env
    has waypoints, at first one, at most ``capacity``. On the CPU that number is
    looked up in each decision, which costs microseconds; elsewhere every 16
    decisions, between which it is taken to grow by one, so that the device is not
    waited for.

    Reference:
        The paper, "Formulate reward function", Fig. 5 and eq. 6.

    Args:
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        compare: embeddings ``[N, D]`` and memory ``[N, M, P]`` to similarities
            ``[N, M]`` in [0, 1].
        prepare: embeddings ``[N, M, D]`` to entries of the memory ``[N, M, P]``,
            computed once a birth; ``None`` keeps the embeddings, ``P = D``.
        capacity: the most waypoints of an episode.
        threshold: a view is mapped if its similarity is above it; in [0, 1). May be
            set anew at any time.
        replacement: which waypoint a birth replaces when the memory is full:
            ``"none"`` (then nothing is born any more), ``"oldest"``, or
            ``"least_visited"`` (ties: the oldest).
        persistence: for how many decisions in a row views must have been novel,
            the one born included; 1 lets every novel view be born.
        min_gap: least number of decisions from one birth to the next.
        count_on: ``"every"`` decision in a place is a visit (the paper's), or only
            the ``"entry"``: the waypoint is another one than the last view was
            mapped to that was mapped at all.
        aggregate: ``"max"`` (the paper's) or a percentile, see
            `aggregate_similarity`; the waypoint is the nearest one either way.
        keep_images: keep the view of each waypoint as it was embedded, for
            `refresh`; 57.6 KB for a waypoint of 160x120, a quarter of it if
            `AreaDownsample` comes first.
        in_keys: key of the views, ``[*B, H, W, C]``, ``pixels`` unless given.
        out_keys: keys of what it writes, each ``[*B, 1]`` but the first: the
            embedding, float32 ``[*B, D]``; the waypoint, int64, -1 for none; the
            similarity before a birth, float32; whether the view is novel and whether
            it is born, bool; the visits of the waypoint, int64, 0 if this decision is
            none; the number of waypoints in memory, int64.

    Raises:
        ValueError: if an argument is out of range; when the env's specs are read, if
            the views are missing or a callable returns another shape; and later, if
            embeddings or similarities are not finite or similarities not in [0, 1].

    Examples:
        Views of one pixel, compared by colour; the second is like the first:

        >>> from tensordict import TensorDict
        >>> def view(red):
        ...     return TensorDict({"pixels": torch.full((1, 1, 1, 1), red)}, [1])
        >>> memory = WaypointMemory(
        ...     embed=lambda views: views.flatten(1),
        ...     compare=lambda one, many: 1 - (one.unsqueeze(1) - many).abs().mean(-1),
        ... )
        >>> start = memory._reset(TensorDict(batch_size=[1]), view(0.0))
        >>> now = [memory._step(TensorDict(), view(red)) for red in (0.1, 0.8, 0.9)]
        >>> [data["similarity"].item() for data in now]
        [0.8999..., 0.1999..., 0.9000...]
        >>> [data["waypoint"].item() for data in now]
        [0, 1, 1]
        >>> [data["born"].item() for data in now]
        [False, True, False]

    Shape notation:
        B: batch of environments.  N: their number.  H, W, C: height, width, channels.
        D: embedding.  M: memory.  P: prepared entry.
    """

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        *,
        prepare: Embed | None = None,
        capacity: int = 200,
        threshold: float = 0.5,
        replacement: Replacement = "none",
        persistence: int = 1,
        min_gap: int = 1,
        count_on: CountOn = "every",
        aggregate: Aggregate = "max",
        keep_images: bool = False,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        check_aggregate(aggregate)
        super().__init__(
            in_keys=[PIXELS] if in_keys is None else in_keys,
            out_keys=_OUT_KEYS if out_keys is None else out_keys,
        )
        if len(self.in_keys) != 1 or len(self.out_keys) != len(_OUT_KEYS):
            raise ValueError(
                f"in_keys must be one key and out_keys {len(_OUT_KEYS)}, "
                f"got {self.in_keys} and {self.out_keys}"
            )
        self.similarity = ViewSimilarity(
            embed,
            compare,
            prepare,
            embedding_key=self.out_keys[0],
            similarity_key=self.out_keys[2],
        )
        self.threshold = threshold
        self.aggregate = aggregate
        self._decisions_blind = 0
        self.slots = WaypointSlots(
            capacity=capacity,
            replacement=replacement,
            persistence=persistence,
            min_gap=min_gap,
            count_on=count_on,
            keep_images=keep_images,
        )

    def clone(self) -> Self:
        copied: Self = super().clone()
        # TorchRL's clones share their modules, but no two envs share an episode.
        copied.slots = deepcopy(self.slots)
        return copied

    @property
    def threshold(self) -> float:
        """A view is mapped if its similarity is above it."""
        return self._threshold

    @threshold.setter
    def threshold(self, threshold: float) -> None:
        if not 0 <= threshold < 1:
            raise ValueError(f"threshold must be in [0, 1), got {threshold}")
        self._threshold = float(threshold)

    def get_extra_state(self) -> dict[str, float]:
        return {"threshold": self.threshold}

    def set_extra_state(self, state: dict[str, float]) -> None:
        self.threshold = state["threshold"]

    @torch.no_grad()
    def refresh(self, threshold: float | None = None, *, chunk: int = 64) -> None:
        """Embed all waypoints anew, after the networks' weights changed.

        Visits and births stay as they are.

        Args:
            threshold: the threshold that fits the new weights; ``None`` keeps it.
            chunk: views embedded in one call.

        Raises:
            ValueError: unless ``keep_images``, or if an argument is out of range.
        """
        if not self.slots.keep_images:
            raise ValueError("keep_images must be True to refresh, got False")
        if chunk < 1:
            raise ValueError(f"chunk must be at least 1, got {chunk}")
        if threshold is not None:
            self.threshold = threshold
        self.slots.look()
        envs, slot = self.slots.live.nonzero(as_tuple=True)
        if not len(envs):
            return
        for some, where in zip(envs.split(chunk), slot.split(chunk), strict=True):
            views = self.slots.images[some, where]
            embedding = self.similarity.embed(views)
            self.similarity.check(embedding)
            entry = self.similarity.entries(embedding)
            self.slots.store(some, where, entry, views)

    @staticmethod
    def _is_near(device: torch.device) -> bool:
        """Whether looking at a number costs nothing, since nothing is waited for."""
        return device.type == "cpu"

    @torch.no_grad()
    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        views = tensordict_reset.get(self.in_keys[0])
        shape, flat = views.shape[:-3], views.reshape(-1, *views.shape[-3:])
        self.slots.follow(len(flat), flat.device)
        reset_keys = ["_reset"] if self.parent is None else self.parent.reset_keys
        rows = reset_rows(tensordict, reset_keys, shape).to(flat.device).reshape(-1)
        envs = rows.nonzero().squeeze(-1)
        embedding = self._begin(envs, flat)
        waypoint, visits = rows.long() - 1, rows.long()
        nothing_like = torch.zeros_like(rows, dtype=torch.float32)
        self._write(
            tensordict_reset,
            shape,
            (embedding, waypoint, nothing_like, rows, rows.clone(), visits),
        )
        return tensordict_reset

    def _begin(self, envs: Tensor, views: Tensor) -> Tensor:
        """Make the views of the rows ``envs`` first waypoints; their embeddings.

        Rows that go on are shown anything, and TorchRL keeps what they had.
        """
        if not len(envs):
            length = self.similarity.embedding_length(views[:1])
            return torch.zeros(len(views), length, device=views.device)
        begun = self.similarity.embed(views[envs])
        self.similarity.check(begun)
        self.slots.restart(envs)
        entry = self.similarity.entries(begun)
        self.slots.store(envs, torch.zeros_like(envs), entry, views[envs])
        embedding = begun.new_zeros(len(views), begun.shape[-1])
        embedding[envs] = begun
        return embedding

    @torch.no_grad()
    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        views = next_tensordict.get(self.in_keys[0])
        shape, flat = views.shape[:-3], views.reshape(-1, *views.shape[-3:])
        slots = self.slots
        slots.follow(len(flat), flat.device)
        embedding = self.similarity.embed(flat)
        known = self._compare(embedding)
        similarity, nearest = known.max(-1)
        if self.aggregate != "max":
            similarity = aggregate_similarity(known, slots.live, self.aggregate)
        novel = similarity <= self.threshold
        waypoint, born, visits = slots.decide(novel, nearest)
        self._store_births(born, waypoint, embedding, flat)
        self._decisions_blind += 1
        if self._is_near(flat.device) or self._decisions_blind >= _LOOK_EVERY:
            self._decisions_blind = 0
            self.similarity.check(embedding, known)
            slots.look()
        similarity = similarity.clamp(0.0, 1.0)
        self._write(
            next_tensordict,
            shape,
            (embedding, waypoint, similarity, novel, born, visits),
        )
        return next_tensordict

    def _compare(self, embedding: Tensor) -> Tensor:
        """Similarity to each waypoint, ``[N, L]``; 0 where there is none."""
        num_slots = self.slots.fullest
        if not num_slots:
            return embedding.new_zeros(len(embedding), 1)
        memory = self.slots.memory[:, :num_slots]
        known = self.similarity.compare(embedding, memory)
        return known.masked_fill(~self.slots.live, 0.0)

    def _store_births(
        self, born: Tensor, waypoint: Tensor, embedding: Tensor, views: Tensor
    ) -> None:
        if self._is_near(born.device):
            envs = born.nonzero().squeeze(-1)
            if len(envs):
                entry = self.similarity.entries(embedding[envs])
                self.slots.store(envs, waypoint[envs], entry, views[envs])
            return
        # How many there are is not asked, so that the device is not waited for.
        envs = torch.arange(len(born), device=born.device)
        entry = self.similarity.entries(embedding)
        self.slots.store(envs, waypoint.clamp(min=0), entry, views, only=born)

    def _write(
        self, tensordict: TensorDictBase, shape: torch.Size, values: Sequence[Tensor]
    ) -> None:
        """Set all ``out_keys``: ``values`` and the number of waypoints."""
        embedding, *flags = values
        flags.append(self.slots.num_waypoints.clone())
        tensordict.set(self.out_keys[0], embedding.reshape(*shape, -1))
        for key, value in zip(self.out_keys[1:], flags, strict=True):
            tensordict.set(key, value.reshape(*shape, 1))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        in_key = self.in_keys[0]
        if in_key not in observation_spec.keys(True, True):
            raise ValueError(f"{in_key!r} must be an observation of the env, got none")
        view = observation_spec[in_key]
        if len(view.shape) < 3:
            raise ValueError(f"{in_key!r} must be images, got {list(view.shape)}")
        shape, device = view.shape[:-3], view.device
        one = view.zero().reshape(-1, *view.shape[-3:])[:1]
        number = Unbounded(shape=(*shape, 1), dtype=torch.int64, device=device)
        truth = Binary(1, shape=(*shape, 1), dtype=torch.bool, device=device)
        length = self.similarity.embedding_length(one)
        specs = [
            Unbounded(shape=(*shape, length), dtype=torch.float32, device=device),
            number,
            Bounded(0.0, 1.0, (*shape, 1), dtype=torch.float32, device=device),
            truth,
            truth.clone(),
            number.clone(),
            number.clone(),
        ]
        for key, spec in zip(self.out_keys, specs, strict=True):
            observation_spec[key] = spec
        return observation_spec
