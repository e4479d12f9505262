"""Thresholds of the TC-network, measured on sequences of random actions.

Nothing here reads ground truth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from toponav.graph.rules import MapRules
from toponav.parts import require_parts

#: Share of the observations that become waypoints of the map: the paper, Table 1, at
#: k = 4, the mean over 30 random sequences.
MAP_SHARE = 0.125
#: The same of the reward's memory. At the map's share jitter earns more than exploring.
#: In select and three generated mazes, of seven shares from 0.5 to 12.5 %, reward
#: follows coverage best at this one (``results/reward_share.json``).
REWARD_SHARE = 0.015

#: Observations compared in one call; few, so that what lies between the layers stays in
#: the processor's cache.
_CHUNK = 16
#: Largest logit tried; one more and float32 rounds the probability to 1.
_WIDEST = 16.0
_MOST_TRIALS = 24
#: How near a share must come to the one asked for, as a share of it.
_CLOSE = 0.02
#: Share of the pairs of views close in time whose similarity passes tc_re.
_PASS_RATE = 0.9
#: How far tc_re stays from its bounds, as a share of what is between them.
_MARGIN = 0.05


class Comparing(Protocol):
    """What calibration asks of a network; `TCNetwork` in ``eval()`` provides it."""

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """``[*B, D]`` and ``[*B, M, P]`` to probabilities ``[*B, M]``."""


class WalkWaypoints:
    """A sequence of observations ``[T, D]``, and which of them become waypoints.

    The paper's first stage of discovery: an observation becomes a waypoint if its
    similarity to *all* waypoints before it is at most the threshold. Every observation
    is compared with all before it, once, and then any threshold takes milliseconds.

    Reference:
        The paper, "Topological map", eq. 9 and the text before it.

    Args:
        embeddings: of the observations.
        network: what compares them.
        episode: number of each observation's episode, ``[T]``, where the world ends
            some within the walk. An ``episodic`` memory, such as the reward's, is empty
            at the start of each; a map's is not.

    Examples:
        >>> class Nearness:
        ...     def prepare_memory(self, memory):
        ...         return memory
        ...     def compare_prepared(self, embedding, prepared):
        ...         return 1 / (1 + (embedding.unsqueeze(-2) - prepared).abs().sum(-1))
        >>> line = torch.tensor([[0.0], [1.0], [2.0], [3.0], [0.5]])
        >>> WalkWaypoints(line, Nearness()).times(0.4)  # up to 1.5 is the same place
        [0, 2]
        >>> episode = torch.tensor([0, 0, 0, 0, 1])
        >>> WalkWaypoints(line, Nearness(), episode).times(0.4, episodic=True)
        [0, 2, 4]
    """

    @torch.no_grad()
    def __init__(
        self, embeddings: Tensor, network: Comparing, episode: Tensor | None = None
    ) -> None:
        if embeddings.ndim != 2 or not len(embeddings):
            rule = "a sequence must be embeddings [T, D] with T >= 1"
            raise ValueError(f"{rule}, got {tuple(embeddings.shape)}.")
        wanted = ("prepare_memory", "compare_prepared")
        require_parts(network, "network", "a TCNetwork", *wanted)
        if episode is None:
            episode = torch.zeros(len(embeddings), dtype=torch.int64)
        if episode.shape != embeddings.shape[:1]:
            rule = f"episode must be [{len(embeddings)}], a number an observation"
            raise ValueError(f"{rule}, got {list(episode.shape)}.")
        #: Number of each observation's episode.
        self.episode = episode.cpu().numpy()
        prepared = network.prepare_memory(embeddings)
        later = torch.full((len(embeddings), len(embeddings)), -1.0)
        for begin in range(0, len(embeddings), _CHUNK):
            rows = embeddings[begin : begin + _CHUNK]
            end = begin + len(rows)
            memory = prepared[:end].expand(len(rows), -1, -1)
            found = network.compare_prepared(rows, memory).float().cpu()
            later[:end, begin:end] = found.T
        later.masked_fill_(torch.ones_like(later, dtype=torch.bool).tril(), -1.0)
        #: Similarity of observation s to an earlier t in row t, column s; else -1.
        self.later = later.numpy()
        if np.isnan(self.later).any():
            raise ValueError("similarities must be numbers, got NaN.")

    def times(self, threshold: float, *, episodic: bool = False) -> list[int]:
        """Times of the waypoints, in order."""
        covered = np.zeros(len(self.later), dtype=np.bool_)
        kept: list[int] = []
        for time in range(len(covered)):
            if not covered[time]:
                kept.append(time)
                alike = self.later[time] > threshold
                if episodic:
                    alike &= self.episode == self.episode[time]
                covered |= alike
        return kept

    def share(self, threshold: float, *, episodic: bool = False) -> float:
        """Waypoints per observation, as in Table 1.

        Of an ``episodic`` memory without those that begin a later episode: they are new
        at any threshold, and where episodes are short no share would be met.
        """
        # A number of Python's: a checkpoint refuses those of NumPy.
        begun = int(np.count_nonzero(np.diff(self.episode))) if episodic else 0
        kept = len(self.times(threshold, episodic=episodic))
        return (kept - begun) / len(self.later)


def share_curve(walks: Sequence[WalkWaypoints], thresholds: Sequence[float]) -> Tensor:
    """Share of waypoints of S walks at K thresholds, float64 ``[S, K]``."""
    shares = [[walk.share(threshold) for threshold in thresholds] for walk in walks]
    return torch.tensor(shares, dtype=torch.float64)


@dataclass(frozen=True)
class Calibration:
    """A threshold and how well it does what it was chosen for."""

    threshold: float  # similarity in [0, 1]; what lies above it counts as close
    target: float  # what was asked for
    achieved: float  # what the threshold gives
    per_sequence: tuple[float, ...] = ()  # ``achieved`` of each, by `calibrate_share`


def calibrate_share(
    walks: Sequence[WalkWaypoints], *, target_share: float, episodic: bool = False
) -> Calibration:
    """Choose tc_th, at which random walks keep a share of waypoints, in (0, 1).

    Bisection over logits, to within 2 % of the target, or the closest threshold tried:
    near 1, where the answer lies, the share is steep in the probability. Longer walks
    come back more often: take complete episodes. ``episodic`` says that the memory is
    empty at the start of each, see `WalkWaypoints`.

    Examples:
        >>> from types import SimpleNamespace
        >>> alike = lambda one, many: 1 - (one.unsqueeze(-2) - many).abs().sum(-1) / 20
        >>> tc = SimpleNamespace(prepare_memory=torch.clone, compare_prepared=alike)
        >>> walk = WalkWaypoints(torch.arange(24.0).unsqueeze(1), tc)
        >>> found = calibrate_share([walk], target_share=0.25)
        >>> walk.times(found.threshold), found.achieved  # six of 24 views
        ([0, 4, 8, 12, 16, 20], 0.25)
    """
    if not walks:
        raise ValueError("walks must hold at least one, got none.")
    if not 0 < target_share < 1:
        raise ValueError(f"target_share must lie in (0, 1), got {target_share}.")

    def measure(logit: float) -> Calibration:
        threshold = 1 / (1 + math.exp(-logit))
        shares = tuple(walk.share(threshold, episodic=episodic) for walk in walks)
        return Calibration(threshold, target_share, sum(shares) / len(shares), shares)

    def error(found: Calibration) -> float:
        return abs(found.achieved - target_share)

    logit, step = 0.0, 1.0
    tried = [measure(logit)]
    while min(map(error, tried)) > _CLOSE * target_share and len(tried) <= _MOST_TRIALS:
        too_few = tried[-1].achieved < target_share
        # Once the answer is passed, every turn halves the step.
        if step < 1 or too_few != (tried[0].achieved < target_share):
            step /= 2
        logit += step if too_few else -step
        if abs(logit) > _WIDEST:
            break
        tried.append(measure(logit))
    return min(tried, key=error)


def calibrate_reach(
    walks: Sequence[WalkWaypoints],
    *,
    tc_threshold: float,
    max_action_distance: int = 4,
) -> Calibration:
    """Choose tc_re, above which one place counts as reachable from another.

    Nine in ten of all pairs of views of an episode that are at most k decisions apart
    (``max_action_distance``) pass: an edge means "an agent gets there in k decisions".
    The paper asks for 0.5 < tc_re < tc_th; a value outside is moved 5 % of that
    interval inside its nearer end, and ``achieved`` then shows the cost. (If tc_th <=
    0.5, tc_re = tc_th.)

    Reference:
        The paper, eqs. 10 and 12; reading 12 of docs/fidelity.md.
    """
    near = [
        np.diagonal(walk.later, apart)[walk.episode[apart:] == walk.episode[:-apart]]
        for walk in walks
        for apart in range(1, max_action_distance + 1)
    ]
    if not any(map(len, near)):
        rule = "an episode must hold two observations"
        raise ValueError(f"{rule}, got one in each.")
    similarity = torch.from_numpy(np.concatenate(near))
    floor = min(0.5, tc_threshold)
    margin = _MARGIN * (tc_threshold - floor)
    threshold = float(similarity.quantile(1 - _PASS_RATE))
    threshold = min(max(threshold, floor + margin), tc_threshold - margin)
    achieved = float((similarity > threshold).double().mean())
    return Calibration(threshold, _PASS_RATE, achieved)


def calibrate_map(
    walks: Sequence[WalkWaypoints], *, max_action_distance: int = 4, **rules: Any
) -> MapRules:
    """Rules of a map with both thresholds calibrated; more ``rules`` as they are given.

    tc_th by `calibrate_share`, to `MAP_SHARE`, and tc_re by `calibrate_reach`, for
    views at most k (``max_action_distance``) decisions apart.

    Examples:
        >>> from types import SimpleNamespace
        >>> alike = lambda one, many: 1 - (one.unsqueeze(-2) - many).abs().sum(-1) / 20
        >>> tc = SimpleNamespace(prepare_memory=torch.clone, compare_prepared=alike)
        >>> walk = WalkWaypoints(torch.arange(40.0).unsqueeze(1), tc)
        >>> rules = calibrate_map([walk], max_action_distance=10)
        >>> walk.times(rules.tc_threshold)  # one view in eight
        [0, 8, 16, 24, 32]
        >>> round(rules.tc_reach, 2)  # what views nine decisions apart have: 1 - 9 / 20
        0.55
    """
    threshold = calibrate_share(walks, target_share=MAP_SHARE).threshold
    reach = calibrate_reach(
        walks, tc_threshold=threshold, max_action_distance=max_action_distance
    )
    return MapRules(tc_threshold=threshold, tc_reach=reach.threshold, **rules)
