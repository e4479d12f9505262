"""`estimate_poses`: where views were taken, from actions and views alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from toponav.graph.poses.closures import (
    Closures,
    drop_turned,
    find_closures,
    find_directions,
    spread_weights,
)
from toponav.graph.poses.least_squares import PositionProblem, redescending
from toponav.graph.poses.odometry import Odometry
from toponav.graph.walks import Walk
from toponav.graph.waypoints import Compare, Embed

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PoseRules:
    """How poses are found. Lengths are steps: what the fastest action goes ahead."""

    #: Views of a similarity above it, in [0, 1), show one place.
    above: float = 0.97
    #: Degrees up to which two views of one place may look different ways.
    tolerance: float = 30.0
    #: One view in so many is compared with others, and with so many of them. Views of
    #: one walk that are at most ``apart`` decisions apart say nothing new.
    every: int = 3
    shortlist: int = 64
    apart: int = 30
    #: Rounds of finding positions and learning steps from them.
    rounds: int = 8
    #: Standard deviations: of a step, and of two views of one place.
    step_error: float = 0.2
    closure_error: float = 3.0
    #: Residuals from which steps and closures stop to count, in the first solution, at
    #: its end, and in the last round.
    step_scales: tuple[float, float, float] = (9.0, 1.8, 0.9)
    closure_scales: tuple[float, float, float] = (27.0, 9.0, 4.5)
    #: How far beyond what positions say of a step its estimate moves: positions follow
    #: the steps that they were found by.
    overshoot: float = 3.0
    #: Share of the moves that nothing stops, at least; they have the known length.
    free_moves: float = 0.3
    seed: int = 0


@dataclass(frozen=True)
class Poses:
    """Where the V views of all walks were taken, in the order of the walks.

    Positions are in steps, and NaN for walks that share no place with the others.
    """

    position: Tensor  # float32 [V, 2]
    heading: Tensor  # float32 [V]; degrees
    kept_closures: int  # pairs of views of one place that fit
    closures: int  # of so many


def estimate_poses(
    walks: Sequence[Walk],
    effects: Tensor,
    compare: Compare,
    prepare: Embed,
    rules: PoseRules,
) -> Poses:
    """Positions and headings of all views, by least squares over actions and places.

    1. Headings are sums of the agent's own turns; closures, pairs of views that the
       TC-network takes for one place, vote how those of the walks belong together.
    2. Positions are those that fit the steps ahead and the closures best. What fits
       nothing, a step into a wall or two places that look alike, loses its weight.
    3. `Odometry` learns from these positions what each step led to, and 2 starts again.

    No pose, plan or depth is read: ``effects`` ``[A, 3]`` are what the A actions do in
    free space, steps ahead and to the left, and degrees to the left.

    Reference:
        Beyond the paper. Pose graphs with robust weights: Sünderhauf and Protzel,
        "Switchable constraints for robust pose graph SLAM" (2012); weights that grow
        strict step by step: Yang et al., "Graduated non-convexity for robust spatial
        perception" (2020), https://arxiv.org/abs/1909.08605
    """
    lengths = [len(walk.actions) for walk in walks]
    walk_of = np.repeat(np.arange(len(walks)), lengths)
    time = np.concatenate([np.arange(length) for length in lengths])
    turned = [effects[walk.actions, 2] for walk in walks]
    headings = torch.cat([turn.cumsum(0) - turn for turn in turned]).double()
    embeddings = torch.cat([walk.embeddings for walk in walks]).float()

    keyframes = np.flatnonzero(time % rules.every == 0)
    closures = find_closures(
        embeddings[keyframes],
        compare,
        prepare,
        above=rules.above,
        shortlist=rules.shortlist,
    )
    closures = Closures(
        keyframes[closures.one], keyframes[closures.other], closures.similarity
    )
    elsewhere = walk_of[closures.one] != walk_of[closures.other]
    later = np.abs(closures.one - closures.other) > rules.apart
    closures = closures.only(elsewhere | later)
    offsets = find_directions(headings, walk_of, closures)
    headings = headings + offsets[walk_of]
    closures = drop_turned(closures, headings, rules.tolerance)

    # A step joins each view but the last of a walk with the next one.
    first = np.flatnonzero(walk_of[:-1] == walk_of[1:])
    actions = torch.cat([walk.actions for walk in walks])
    steps = _Steps(first, headings.numpy(), actions, effects, embeddings, rules)
    position, kept = _solve(steps, closures, len(walk_of), rules)
    position[headings.isnan().numpy()] = np.nan
    return Poses(
        torch.from_numpy(position).float(), headings.float(), kept, len(closures)
    )


class _Steps:
    """The S steps of all walks, seen from the agent, and what is known of them."""

    def __init__(
        self,
        first: NDArray[np.int64],
        headings: Floats,
        actions: Tensor,
        effects: Tensor,
        embeddings: Tensor,
        rules: PoseRules,
    ) -> None:
        self.first = first
        angle = np.deg2rad(np.nan_to_num(headings[first]))
        self._cos, self._sin = np.cos(angle), np.sin(angle)
        self._rules = rules
        #: Ahead and to the left, ``[S, 2]``.
        self.estimate: Floats = effects[actions[first], :2].double().numpy()
        self._longest = np.linalg.norm(self.estimate, axis=1)
        before = np.maximum(first - 1, 0)
        done = torch.stack([actions[before], actions[first]], 1)
        self._odometry = Odometry(
            embeddings[first],
            embeddings[first + 1],
            done,
            len(effects),
            seed=rules.seed,
        )

    def in_the_plan(self) -> Floats:
        """The steps as differences of positions, ``[S, 2]``."""
        ahead, left = self.estimate.T
        return np.stack(
            [
                ahead * self._cos - left * self._sin,
                ahead * self._sin + left * self._cos,
            ],
            1,
        )

    def learn(self, positions: Floats) -> None:
        """Move the estimates to what positions say of them, and smooth them."""
        east, north = (positions[self.first + 1] - positions[self.first]).T
        said = np.stack(
            [
                east * self._cos + north * self._sin,
                north * self._cos - east * self._sin,
            ],
            1,
        )
        wanted = self.estimate + self._rules.overshoot * (said - self.estimate)
        found = self._odometry.fit(self._limited(wanted))
        # Positions shrink where steps are not held: free moves have the known length.
        moves = self._longest > 0.6
        share = np.linalg.norm(found[moves], axis=1) / self._longest[moves]
        unit = np.quantile(share, 1 - self._rules.free_moves) if moves.any() else 1.0
        self.estimate = self._limited(found / max(unit, 1e-3))

    def _limited(self, steps: Floats) -> Floats:
        """No longer than in free space, but for what is carried over from the last."""
        length = np.linalg.norm(steps, axis=1)
        most = (self._longest + 0.1) / np.maximum(length, 1e-6)
        return steps * np.minimum(1.0, most)[:, None]


def _solve(
    steps: _Steps, closures: Closures, num: int, rules: PoseRules
) -> tuple[Floats, int]:
    """The positions, and how many closures fit them."""
    weight = np.full(len(steps.first), rules.step_error**-2)
    joins = spread_weights(closures, num) * rules.closure_error**-2
    nothing = np.zeros((len(closures), 2))
    one = np.concatenate([steps.first, closures.one])
    other = np.concatenate([steps.first + 1, closures.other])
    positions, trust = np.zeros((num, 2)), np.ones(len(one))
    split = len(steps.first)
    for turn in tqdm(range(rules.rounds), desc="poses", leave=False):
        said = np.concatenate([steps.in_the_plan(), nothing])
        problem = PositionProblem(num, one, other, said)
        inner = 8 if turn == 0 else 3
        for at in range(inner):
            positions = problem.solve(
                np.concatenate([weight, joins]) * trust, positions
            )
            done = at / (inner - 1) if turn == 0 else turn / (rules.rounds - 1)
            scales = [
                _between(*(some[:2] if turn == 0 else some[1:]), done)
                for some in (rules.step_scales, rules.closure_scales)
            ]
            residual = problem.residual(positions)
            trust = np.concatenate(
                [
                    redescending(residual[:split], scales[0]),
                    redescending(residual[split:], scales[1]),
                ]
            )
        if turn == 0:
            weight = weight * 2
        steps.learn(positions)
    return positions, int((trust[split:] > 0.25).sum())


def _between(first: float, last: float, done: float) -> float:
    """From one number to another, in equal factors."""
    return first * (last / first) ** done
