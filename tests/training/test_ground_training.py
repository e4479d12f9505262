"""A network that learns from views where the ground is free."""

import pytest
import torch

from tests.graph.poses.ring_world import walk
from toponav.graph.poses import WalkedGround
from toponav.training.ground_training import GroundRules, train_ground

RULES = GroundRules(updates=400, views=128)


@pytest.fixture(scope="module")
def ring() -> tuple[torch.Tensor, torch.Tensor]:
    """Embeddings and poses of views."""
    parts = [walk(env, 400, seed=env) for env in range(3)]
    embeddings = torch.cat([one.embeddings for one, _ in parts])
    return embeddings, torch.cat([true for _, true in parts])


def test_it_knows_more_of_new_views_than_their_mean(ring) -> None:
    network = train_ground(*ring, RULES)
    seen, poses = walk(9, 300, seed=9)
    ground = WalkedGround(ring[1][:, :2])
    wanted = ground.before(poses).float()
    with torch.no_grad():
        chance = network(seen.embeddings.float()).sigmoid()
    mean = ground.before(ring[1]).float().mean(0)
    error = (chance - wanted).square().mean()
    # Seen: 0.77, as the 1,200 views are few.
    assert error < 0.85 * (mean - wanted).square().mean()


def test_views_whose_pose_is_not_known_are_left_out(ring) -> None:
    embeddings, poses = ring
    lost = poses.clone()
    lost[600:] = torch.nan
    rules = GroundRules(updates=3)
    some = train_ground(embeddings, lost, rules)
    alone = train_ground(embeddings[:600], poses[:600], rules)
    for one, other in zip(some.parameters(), alone.parameters(), strict=True):
        assert torch.equal(one, other)
    with pytest.raises(ValueError, match="a view must have a known pose, got none"):
        train_ground(embeddings, poses * torch.nan, rules)


def test_a_seed_repeats_it_and_leaves_other_draws_alone(ring) -> None:
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    one = train_ground(*ring, GroundRules(updates=3))
    assert torch.equal(torch.rand(3), wanted)
    other = train_ground(*ring, GroundRules(updates=3))
    third = train_ground(*ring, GroundRules(updates=3, seed=1))
    first = one.layers[0].weight
    assert torch.equal(first, other.layers[0].weight)
    assert not torch.equal(first, third.layers[0].weight)
