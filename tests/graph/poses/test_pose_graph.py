"""`estimate_poses`: positions of views from actions and views alone."""

import numpy as np
import pytest
import torch

from tests.graph.poses.ring_world import EFFECTS, compare, walk
from toponav.graph.poses import PoseRules, estimate_poses
from toponav.graph.poses.closures import Closures, drop_turned, find_closures
from toponav.graph.poses.directions import find_directions
from toponav.graph.poses.least_squares import PositionProblem, redescending
from toponav.graph.poses.odometry import Odometry

RULES = PoseRules(above=0.8, every=2, rounds=5, updates=200, seed=1)


def misplaced(found: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Distances after the best rotation and shift, ``[V]``."""
    one, other = found - found.mean(0), truth - truth.mean(0)
    left, _, right = torch.linalg.svd(one.T @ other)
    return (one @ (left @ right) - other).norm(dim=-1)


@pytest.fixture(scope="module")
def walks():
    made = [walk(env, 500, seed=env) for env in range(6)]
    return [one for one, _ in made], torch.cat([poses for _, poses in made])


@pytest.fixture(scope="module")
def poses(walks):
    return estimate_poses(walks[0], EFFECTS, compare, torch.Tensor.float, RULES)


def test_views_are_placed_far_better_than_by_actions_alone(walks, poses) -> None:
    truth = walks[1]
    by_actions = []
    for one, true in zip(walks[0], truth.split(500), strict=True):
        moved = EFFECTS[one.actions, 0].unsqueeze(1)
        angle = true[:, 2].deg2rad()
        steps = moved * torch.stack([angle.cos(), angle.sin()], 1)
        by_actions.append(true[0, :2] + steps.cumsum(0) - steps)
    off = (torch.cat(by_actions) - truth[:, :2]).norm(dim=-1)
    error = misplaced(poses.position, truth[:, :2])
    # Walls hold the agent back: by its actions alone it is soon outside of the world.
    assert off.median() > 20
    assert error.median() < 3
    assert error.quantile(0.9) < 7


def test_headings_count_alike_in_all_walks(walks, poses) -> None:
    turned = poses.heading - walks[1][:, 2]
    apart = (turned - turned[0] + 180) % 360 - 180
    assert apart.abs().max() < 15  # degrees, of 360 that the walks began with
    assert poses.known == 1
    # The two corners that look alike are a small part of the views.
    assert 0.75 < poses.fit < 1


def test_the_same_walks_give_the_same_poses(walks, poses) -> None:
    again = estimate_poses(walks[0], EFFECTS, compare, torch.Tensor.float, RULES)
    assert torch.equal(again.position, poses.position)


def test_no_draw_of_the_caller_is_changed(walks) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    short = [walk(0, 60, seed=3)[0]]
    estimate_poses(short, EFFECTS, compare, torch.Tensor.float, RULES)
    assert torch.equal(torch.rand(3), expected)


def test_a_walk_that_shares_no_place_has_no_pose(walks) -> None:
    alone, _ = walk(7, 50, seed=7)
    alone = type(alone)(7, 0, alone.embeddings + 1000, alone.actions)
    some = [*walks[0][:2], alone]
    found = estimate_poses(some, EFFECTS, compare, torch.Tensor.float, RULES)
    assert found.position[-50:].isnan().all()
    assert found.heading[-50:].isnan().all()
    assert found.position[:-50].isfinite().all()
    assert found.known == pytest.approx(1000 / 1050)


def test_a_pair_of_one_place_is_found_once() -> None:
    embeddings = torch.tensor([[0.0, 0, 0, 0], [0.1, 0, 0, 0], [9.0, 0, 0, 0]])
    found = find_closures(embeddings, compare, torch.Tensor.float, above=0.9)
    assert (found.one.tolist(), found.other.tolist()) == ([0], [1])


def test_closures_between_different_directions_go() -> None:
    closures = Closures(np.array([0, 0, 0]), np.array([1, 2, 3]))
    headings = torch.tensor([350.0, 10.0, 40.0, torch.nan])
    assert drop_turned(closures, headings, 30.0).other.tolist() == [1]


def test_directions_are_those_that_most_closures_say() -> None:
    # The second walk began turned by 120 degrees; a third of its closures are wrong.
    headings = torch.zeros(60)
    walk_of = np.repeat([0, 1], 30)
    headings[:30] = torch.arange(30) * 20.0
    headings[30:] = headings[:30] - 120
    headings[50:] += torch.arange(10) * 36.0 + 90
    closures = Closures(np.arange(30), np.arange(30) + 30)
    offsets = find_directions(headings, walk_of, closures)
    assert offsets.tolist() == pytest.approx([0, 120], abs=1)


def test_a_pair_that_fits_nothing_loses_its_weight() -> None:
    # A line of four steps; what says that its ends are one place is 4 steps wrong.
    one, other = np.array([0, 1, 2, 3, 0]), np.array([1, 2, 3, 4, 4])
    steps = np.array([[1.0, 0.0]] * 4 + [[0.0, 0.0]])
    problem, weights = PositionProblem(5, one, other, steps), np.ones(5)
    found = problem.solve(weights, np.zeros((5, 2)))
    # Equal weights share the error: each of the five pairs is 4 / 5 off.
    assert problem.residual(found) == pytest.approx([0.8] * 5, abs=1e-3)
    for scale in (2.0, 1.0, 0.5, 0.5):
        weights = redescending(problem.residual(found), scale)
        weights[:4] = 1.0
        found = problem.solve(weights, found)
    assert (found[4] - found[0]).tolist() == pytest.approx([4.0, 0.0], abs=0.05)


def test_odometry_learns_what_walls_do() -> None:
    torch.manual_seed(0)
    before = torch.rand(800, 2)
    after = before + 0.1 * torch.rand(800, 2)
    blocked = before[:, 0] > 0.6
    steps = np.stack([np.where(blocked, 0.0, 1.0), np.zeros(800)], 1)
    noisy = steps + np.random.default_rng(0).normal(0, 0.5, steps.shape)
    actions = torch.zeros(800, 2, dtype=torch.int64)
    found = Odometry(before, after, actions, 3, updates=300, seed=0).fit(noisy)
    # Noise of 0.4 in the mean becomes less than half of it.
    assert np.abs(noisy - steps).mean() > 0.38
    assert np.abs(found - steps).mean() < 0.18
