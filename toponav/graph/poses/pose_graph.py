"""`estimate_poses`: where views were taken, from actions and views alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from toponav.graph.poses.closures import (
    Closures,
    drop_turned,
    find_closures,
    spread_weights,
)
from toponav.graph.poses.confirmation import ConfirmRules, confirm_closures
from toponav.graph.poses.directions import find_directions
from toponav.graph.poses.frames import poses_by_actions
from toponav.graph.poses.least_squares import PositionProblem, redescending
from toponav.graph.poses.steps import Steps
from toponav.graph.trajectories import Trajectory
from toponav.graph.waypoints import Compare, Embed

Floats = NDArray[np.float64]

#: Solutions of the first round, and of each later one.
_FIRST, _LATER = 8, 3
#: Weight from which a closure fits.
_FITS = 0.25


@dataclass(frozen=True, kw_only=True)
class PoseRules:
    """How poses are found. Lengths are steps: what the fastest action goes ahead."""

    #: Views of a similarity above it, in [0, 1), show one place: a map's threshold.
    above: float
    #: Degrees up to which two views of one place may look different ways.
    tolerance: float = 30.0
    #: One view in so many is compared with others, and with so many of them. Views of
    #: one walk that are at most ``apart`` decisions apart say nothing new.
    every: int = 3
    shortlist: int = 64
    apart: int = 30
    #: If less than this share of the views has a direction by all pairs of views that
    #: show one place, those alone count that others confirm.
    least_known: float = 0.8
    confirm: ConfirmRules = field(default_factory=ConfirmRules)
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
    #: Of the network that learns the steps, in each round.
    updates: int = 600
    seed: int = 0

    def scales(self, turn: int) -> list[tuple[float, float]]:
        """Residuals from which steps and closures stop to count, solution by solution.

        Examples:
            >>> rules = PoseRules(above=0.9, rounds=2, step_scales=(8.0, 2.0, 0.5))
            >>> [round(step, 2) for step, _ in rules.scales(1)]
            [0.5, 0.5, 0.5]
        """
        both = self.step_scales, self.closure_scales
        if turn == 0:
            shares = np.linspace(0, 1, _FIRST).tolist()
            ends = [some[:2] for some in both]
        else:
            shares = [turn / max(self.rounds - 1, 1)] * _LATER
            ends = [some[1:] for some in both]
        (a, b), (c, d) = ends
        # In equal factors.
        return [(a * (b / a) ** at, c * (d / c) ** at) for at in shares]


@dataclass(frozen=True)
class Poses:
    """Where the V views of all walks were taken, in the order of the walks.

    Positions are in steps, and NaN for walks that share no place with the others.
    """

    position: Tensor  # float32 [V, 2]
    heading: Tensor  # float32 [V]; degrees
    fit: float  # share of the pairs of views that look like one place and are one

    @property
    def known(self) -> float:
        """Share of the views whose pose is known."""
        return float(self.heading.isfinite().float().mean())


def estimate_poses(
    walks: Sequence[Trajectory],
    effects: Tensor,
    compare: Compare,
    prepare: Embed,
    rules: PoseRules,
    progress: Callable[[float], object] = lambda _: None,
) -> Poses:
    """Positions and headings of all views, by least squares over actions and places.

    1. Headings are sums of the agent's own turns; closures, pairs of views that the
       TC-network takes for one place, vote how those of the walks belong together.
       Where many places look alike, only those do that others confirm
       (`confirm_closures`).
    2. Positions are those that fit the steps ahead and the closures best. What fits
       nothing, a step into a wall or two places that look alike, loses its weight.
    3. `Odometry` learns from these positions what each step led to, and 2 starts again.

    No pose, plan or depth is read: ``effects`` ``[A, 3]`` are what the A actions do in
    free space, steps ahead and to the left, and degrees to the left. ``progress`` is
    called with the share of 2 and 3 that is done.

    Reference:
        Beyond the paper. Pose graphs with robust weights: Sünderhauf and Protzel,
        "Switchable constraints for robust pose graph SLAM" (2012); weights that grow
        strict step by step: Yang et al., "Graduated non-convexity for robust spatial
        perception" (2020), https://arxiv.org/abs/1909.08605
    """
    lengths = [len(walk.actions) for walk in walks]
    walk_of = np.repeat(np.arange(len(walks)), lengths)
    by_actions = torch.cat([poses_by_actions(effects[walk.actions]) for walk in walks])
    headings = by_actions[:, 2]
    embeddings = torch.cat([walk.embeddings for walk in walks]).float()
    closures = _closures(embeddings, walk_of, lengths, compare, prepare, rules)
    directions = find_directions(headings, walk_of, closures)[walk_of]
    if directions.isfinite().double().mean() < rules.least_known:
        places = by_actions[:, :2].numpy()
        closures = confirm_closures(
            closures, walk_of, headings.numpy(), places, rules.confirm
        )
        directions = find_directions(headings, walk_of, closures)[walk_of]
    headings = headings + directions
    closures = drop_turned(closures, headings, rules.tolerance)
    steps = Steps(
        # A step joins each view but the last of a walk with the next one.
        np.flatnonzero(walk_of[:-1] == walk_of[1:]),
        headings.numpy(),
        torch.cat([walk.actions for walk in walks]),
        effects,
        embeddings,
        overshoot=rules.overshoot,
        free_moves=rules.free_moves,
        updates=rules.updates,
        seed=rules.seed,
    )
    position, kept = _solve(steps, closures, len(walk_of), rules, progress)
    position[headings.isnan().numpy()] = np.nan
    fit = kept / max(len(closures), 1)
    return Poses(torch.from_numpy(position).float(), headings.float(), fit)


def _closures(
    embeddings: Tensor,
    walk_of: NDArray[np.int64],
    lengths: Sequence[int],
    compare: Compare,
    prepare: Embed,
    rules: PoseRules,
) -> Closures:
    """Pairs of views of one place, but for those of one moment."""
    time = np.concatenate([np.arange(length) for length in lengths])
    frames = np.flatnonzero(time % rules.every == 0)
    found = find_closures(
        embeddings[frames],
        compare,
        prepare,
        above=rules.above,
        shortlist=rules.shortlist,
    )
    found = Closures(frames[found.one], frames[found.other])
    elsewhere = walk_of[found.one] != walk_of[found.other]
    later = np.abs(found.one - found.other) > rules.apart
    return found.only(elsewhere | later)


def _solve(
    steps: Steps,
    closures: Closures,
    num: int,
    rules: PoseRules,
    progress: Callable[[float], object],
) -> tuple[Floats, int]:
    """The positions, and how many closures fit them."""
    # Learning from positions takes about as long as one solution.
    total = _FIRST + 1 + (rules.rounds - 1) * (_LATER + 1)
    done = count(1)
    split = len(steps.first)
    weights = np.full(split, rules.step_error**-2)
    joins = spread_weights(closures, num) * rules.closure_error**-2
    nothing = np.zeros((len(closures), 2))
    one = np.concatenate([steps.first, closures.one])
    other = np.concatenate([steps.first + 1, closures.other])
    positions, trust = np.zeros((num, 2)), np.ones(len(one))
    for turn in tqdm(range(rules.rounds), desc="poses", leave=False):
        said = np.concatenate([steps.in_the_plan(), nothing])
        problem = PositionProblem(num, one, other, said)
        for step_scale, closure_scale in rules.scales(turn):
            weighted = np.concatenate([weights, joins]) * trust
            positions = problem.solve(weighted, positions)
            fits = np.split(problem.residual(positions), [split])
            scales = step_scale, closure_scale
            trust = np.concatenate(
                [redescending(*some) for some in zip(fits, scales, strict=True)]
            )
            progress(next(done) / total)
        if turn == 0:
            weights = 2 * weights  # learned steps are better than those of free space
        steps.learn(positions)
        progress(next(done) / total)
    return positions, int((trust[split:] > _FITS).sum())
