"""`consolidate`: a map made again of few waypoints, by the poses of its views."""

from collections import Counter

import torch
from tensordict import TensorDict

from tests.graph.poses.ring_world import EFFECTS, compare, walk
from toponav.graph import MapRules, PoseRules, TopologicalMap, Trajectories, consolidate
from toponav.graph.pieces import Piece
from toponav.graph.poses import (
    MoveRules,
    Poses,
    SupportRules,
    decisions_apart,
    trusted_moves,
)

RULES = PoseRules(above=0.8, every=2, rounds=4, updates=150)
LIMITS = {"within": 3.0, "above": 0.1}


def grown(number=3, *, walks=True, length=300, apart=0.0, ends=True):
    rules = MapRules(tc_threshold=0.8, tc_reach=0.5, edges="time")
    topological_map = TopologicalMap(
        torch.Tensor.float, compare, rules, walks=Trajectories() if walks else None
    )
    poses = []
    for env in range(number):
        one, true = walk(env, length, seed=env)
        done = torch.zeros(1, length, 1, dtype=torch.bool)
        done[:, -1] = ends
        batch = TensorDict(
            {
                "embedding": one.embeddings.float().unsqueeze(0) + env * apart,
                "action": one.actions.unsqueeze(0),
                "env_id": torch.full((1, length, 1), env),
                "next": {"done": done},
            },
            [1, length],
        )
        for piece in batch.split(100, 1):
            topological_map.extend(piece.contiguous())
        poses.append(true)
    return topological_map, poses


def test_few_waypoints_and_edges_that_were_walked() -> None:
    topological_map, poses = grown()
    before = topological_map.waypoints.origins.clone()
    many = topological_map.num_waypoints
    found = consolidate(topological_map, EFFECTS, RULES, **LIMITS)
    kept, number = found.kept, topological_map.num_waypoints
    assert number == len(kept) < many / 2
    assert torch.equal(topological_map.waypoints.origins, before[kept])
    assert (topological_map.graph.traversals.sum(1) > 0).all()
    # Waypoints stand for views at most 4 decisions away, so that those of an edge are
    # at most 9 apart: a step between two views comes on top.
    place = torch.stack([poses[env][at] for env, at in before[kept].tolist()])
    one, other = topological_map.edges.unbind(1)
    assert ((place[one] - place[other])[:, :2].norm(dim=-1) < 9).float().mean() > 0.98
    # Positions say how long an edge is.
    own = topological_map.waypoints.positions
    said = (own[one] - own[other]).norm(dim=-1)
    true = (place[one] - place[other])[:, :2].norm(dim=-1)
    assert (said - true).abs().median() < 1.0
    # Poses of all views: those of the waypoints are among them.
    assert found.poses.shape == (len(found.embeddings), 3) == (900, 3)
    assert torch.cdist(own, found.poses[:, :2]).amin(1).max() < 0.05
    # Headings are those of the views, but for one angle that all share.
    turned = (topological_map.waypoints.headings - place[:, 2]).deg2rad()
    assert torch.stack([turned.cos().mean(), turned.sin().mean()]).norm() > 0.98


def test_a_map_without_walks_or_poses_stays_as_it_is() -> None:
    topological_map, _ = grown(2, walks=False)
    state = topological_map.state_dict()
    found = consolidate(topological_map, EFFECTS, RULES, **LIMITS)
    assert found.embeddings is None
    assert found.poses is None
    assert found.kept.tolist() == [*range(topological_map.num_waypoints)]
    # Two walks through different worlds: the second one's views, half of all, have no
    # pose beside those of the first.
    topological_map, _ = grown(2, apart=100.0)
    state = topological_map.state_dict()
    found = consolidate(topological_map, EFFECTS, RULES, **LIMITS)
    assert found.embeddings is None
    assert found.poses is None
    assert found.kept.tolist() == [*range(topological_map.num_waypoints)]
    assert torch.equal(topological_map.edges, state["edges"])


def test_views_without_a_step_between_them_stay_as_they_are() -> None:
    topological_map, _ = grown(2, length=1)
    found = consolidate(topological_map, EFFECTS, RULES, **LIMITS)
    assert found.poses is None
    assert topological_map.num_waypoints == len(found.kept) > 0


def test_walks_go_on_after_a_resume() -> None:
    whole, _ = grown(1, length=200, ends=False)
    assert whole.walks is not None
    again = Trajectories()
    again.load_state_dict(whole.walks.state_dict())
    again.resume_episodes(whole.walks.running_episodes())
    one, _ = walk(0, 200, seed=0)
    piece = Piece(0, one.embeddings, None, True, actions=one.actions)
    again.extend([piece])
    # One walk, which the resume did not end; the next one's views count on.
    (joined,) = again.all()
    assert torch.equal(joined.embeddings, one.embeddings.repeat(2, 1))
    assert torch.equal(joined.actions, one.actions.repeat(2))
    again.extend([piece])
    assert [each.number for each in again.all()] == [0, 400]


def test_a_walk_that_goes_on_keeps_no_views_and_no_batch() -> None:
    walks, views = Trajectories(), torch.zeros(4, 50, 6, 8, 3, dtype=torch.uint8)
    for _ in range(3):
        batch, actions = torch.rand(4, 50, 32), torch.zeros(4, 50, dtype=torch.int64)
        rows = zip(batch, views, actions, strict=True)
        walks.extend(
            [
                Piece(env, row, seen, False, turns=done.float(), actions=done)
                for env, (row, seen, done) in enumerate(rows)
            ]
        )
    pieces = [piece for found in walks._running.values() for piece in found]
    kept = [part for piece in pieces for part in vars(piece).values()]
    stored = {
        part.untyped_storage().data_ptr(): part.untyped_storage().nbytes()
        for part in kept
        if isinstance(part, torch.Tensor)
    }
    # Two bytes a number of an embedding, and eight of an action.
    assert sum(stored.values()) == 3 * 4 * 50 * (2 * 32 + 8)
    assert torch.equal(walks.all()[3].embeddings[-50:], batch[3].half())


def test_waypoints_of_a_stretch_in_the_wrong_place_stay_where_none_other_is(
    monkeypatch,
) -> None:
    # Three walks around the same corridor; 60 views of the last one lie opposite in
    # the square, where others saw something else.
    poses = torch.cat([walk(env, 300, seed=env)[1] for env in range(3)])
    poses[700:760, :2] = 16.0 - poses[700:760, :2]
    found = Poses(poses[:, :2], poses[:, 2], fit=1.0)
    monkeypatch.setattr("toponav.graph.consolidation.estimate_poses", lambda *_: found)

    def beside_others(rules):
        """Of the waypoints in the wrong place, how many have others nearby."""
        topological_map, _ = grown()
        before = topological_map.waypoints.origins.clone()
        kept = consolidate(
            topological_map, EFFECTS, RULES, **LIMITS, support_rules=rules
        ).kept
        env, at = before[kept].unbind(1)
        is_wrong = (env == 2) & (at >= 100) & (at < 160)
        of = poses[env * 300 + at].double().numpy()
        apart = decisions_apart(of[is_wrong, None], of[~is_wrong], 20.0)
        return int((apart <= LIMITS["within"]).any(1).sum())

    # If nobody is asked, all are doubted, or by a least support of 0 none.
    assert beside_others(SupportRules(most=0, least=0)) > 0
    assert beside_others(None) == 0


def test_waypoints_that_hang_on_one_move_go() -> None:
    one, _ = grown()
    whole = consolidate(
        one, EFFECTS, RULES, **LIMITS, move_rules=MoveRules(there_and_back=0)
    ).kept.tolist()
    other, _ = grown()
    kept = consolidate(other, EFFECTS, RULES, **LIMITS).kept.tolist()
    gone = [at for at, number in enumerate(whole) if number not in kept]
    assert gone
    assert set(kept) < set(whole)
    ends = one.edges.flatten().tolist()
    assert {ends.count(at) for at in gone} == {1}


def test_a_waypoint_that_no_move_joins_goes(monkeypatch) -> None:
    def without_the_first(moves, *rest):
        moves = trusted_moves(moves, *rest)
        return Counter({pair: moves[pair] for pair in moves if 0 not in pair})

    limits = LIMITS | {"move_rules": MoveRules(there_and_back=0)}
    one, _ = grown()
    whole = consolidate(one, EFFECTS, RULES, **limits)
    monkeypatch.setattr("toponav.graph.consolidation.trusted_moves", without_the_first)
    other, _ = grown()
    found = consolidate(other, EFFECTS, RULES, **limits)
    assert torch.equal(found.kept, whole.kept[1:])
    # The others keep their poses and edges, under numbers one lower.
    assert torch.equal(other.waypoints.poses, one.waypoints.poses[1:])
    kept = (one.edges > 0).all(1)
    assert {*map(tuple, other.edges.tolist())} == {
        *map(tuple, (one.edges[kept] - 1).tolist())
    }
