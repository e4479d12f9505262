"""A network that learns a map's waypoints by their views."""

import pytest
import torch

from tests.graph.poses.ring_world import EFFECTS, walk
from toponav.training.place_training import (
    OffsetRules,
    PlaceRules,
    train_offsets,
    train_places,
)

RULES = PlaceRules(updates=250, views=128)
OFFSETS = OffsetRules(updates=300, views=128)
TURN = float(EFFECTS[:, 2].max())


@pytest.fixture(scope="module")
def ring():
    """Embeddings and poses of views, and the poses of waypoints among them."""
    parts = [walk(env, 400, seed=env) for env in range(3)]
    embeddings = torch.cat([one.embeddings for one, _ in parts])
    poses = torch.cat([true for _, true in parts])
    return embeddings, poses, poses[::20]


def test_new_views_are_found_at_the_nearest_waypoints(ring) -> None:
    places = train_places(*ring, TURN, RULES)
    seen, poses = walk(9, 300, seed=9)
    with torch.no_grad():
        chance = places(seen.embeddings.float()).softmax(1)
    found = ring[2][chance.argmax(1)]
    away = (found - poses)[:, :2].norm(dim=1)
    # Of 60 waypoints in 176 square steps; one drawn at random is 9 steps away.
    assert away.median() < 2
    assert (away < 4).float().mean() > 0.7


def test_views_whose_pose_is_not_known_are_left_out(ring) -> None:
    embeddings, poses, waypoints = ring
    lost = poses.clone()
    lost[600:] = torch.nan
    some = train_places(embeddings, lost, waypoints, TURN, RULES)
    alone = train_places(embeddings[:600], poses[:600], waypoints, TURN, RULES)
    assert torch.equal(some.mean, alone.mean)
    assert all(weight.isfinite().all() for weight in some.parameters())
    with pytest.raises(ValueError, match="a view must have a known pose near a way"):
        train_places(embeddings, poses * torch.nan, waypoints, TURN, RULES)


def test_a_seed_repeats_it_and_leaves_other_draws_alone(ring) -> None:
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    one = train_places(*ring, TURN, PlaceRules(updates=3))
    assert torch.equal(torch.rand(3), wanted)
    other = train_places(*ring, TURN, PlaceRules(updates=3))
    third = train_places(*ring, TURN, PlaceRules(updates=3, seed=1))
    same, unlike = (
        [
            torch.equal(one, other)
            for one, other in zip(one.parameters(), them.parameters(), strict=True)
        ]
        for them in (other, third)
    )
    assert all(same)
    assert not all(unlike)


def test_offsets_say_where_between_waypoints_a_view_is(ring) -> None:
    waypoints = ring[2]
    places = train_places(*ring, TURN, RULES)
    offsets = train_offsets(*ring, TURN, OFFSETS)
    seen, poses = walk(9, 300, seed=9)
    views = seen.embeddings.float()
    with torch.no_grad():
        nearest, found = places(views).argmax(1), offsets(views)
    said = waypoints[nearest] + found[torch.arange(len(views)), nearest]
    away = (said - poses)[:, :2].norm(dim=1)
    away_without = (waypoints[nearest] - poses)[:, :2].norm(dim=1)
    assert away.median() < 0.8 * away_without.median()
    turned = ((said - poses)[:, 2] + 180) % 360 - 180
    turned_without = ((waypoints[nearest] - poses)[:, 2] + 180) % 360 - 180
    assert turned.abs().median() < 0.6 * turned_without.abs().median()


def test_offsets_go_the_short_way_round(ring) -> None:
    # All views look 350 degrees, all waypoints 10: 20 degrees to the right of them.
    embeddings, poses, waypoints = (one.clone() for one in ring)
    poses[:, 2], waypoints[:, 2] = 350.0, 10.0
    offsets = train_offsets(embeddings, poses, waypoints, 1e6, OFFSETS)
    with torch.no_grad():
        found = offsets(embeddings.float())[:, :, 2]
    # Not 340.
    assert found.median().item() == pytest.approx(-20, abs=6)
