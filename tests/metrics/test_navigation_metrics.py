import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from tensordict import TensorDict

from toponav.ground_truth import GroundTruthDistances, pick_goal_views
from toponav.metrics import (
    NavigationTrace,
    classify_decisions,
    detection_delays,
    find_legs,
    first_goal,
    judge_cuts,
    mean_detour,
    measure_legs,
    slow_legs,
    success_weighted_by_length,
    success_within,
    trace_navigation,
)
from toponav.metrics.navigation_metrics import FAULTS

# A ring of 5 x 3 cells with a slot in the middle of its upper side; 128 units a cell.
#   . . a . .
#   . # # # .
#   . . . . .
RING = torch.tensor([[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 1, 1, 1, 1]]).bool()
SLOT = (0, 2)
DISTANCES = GroundTruthDistances(RING, cell_size=128.0, slot_cells=[SLOT])


def trace_of(cells, *, reached=(), goal=(0, 4), closed=False, **decided):
    """One episode along the middles of cells."""
    length = len(cells)
    shape = (1, length)
    hit = np.zeros(shape, bool)
    hit[0, list(reached)] = True
    nothing = {name: np.full(shape, -1) for name in ("place", "target", "goal_node")}
    nothing |= {name: np.full(shape, -1) for name in ("cut_from", "cut_to")}
    given_ = {name: np.array([values]) for name, values in decided.items()}
    return NavigationTrace(
        positions=DISTANCES.centres([cells]),
        headings=np.zeros(shape),
        cells=np.array([cells]),
        goal_cells=np.broadcast_to(np.array(goal), (*shape, 2)),
        blocked=np.full((*shape, 1), closed),
        reward=10.0 * hit,
        reached=hit,
        **(nothing | {"lost": np.zeros(shape, bool)} | given_),
    )


STRAIGHT = [(0, 0), (0, 1), (0, 2), (0, 3)]
AROUND = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (2, 3), (2, 4), (1, 4)]


def test_goals_and_first_goal():
    trace = trace_of(STRAIGHT + AROUND, reached=(3, 11))
    assert first_goal(trace).tolist() == [4]
    assert first_goal(trace_of(STRAIGHT)).tolist() == [-1]
    legs = find_legs(trace)[["episode", "start", "end", "reached"]]
    assert legs.to_numpy().tolist() == [[0, 0, 4, True], [0, 4, 12, True]]
    cut_off = find_legs(trace_of(STRAIGHT, reached=(1,))).iloc[-1]
    assert (cut_off.decisions, cut_off.reached) == (2, False)


def test_lengths_of_legs():
    measures = measure_legs(trace_of(STRAIGHT + AROUND, reached=(3, 11)), DISTANCES)
    # Three and seven steps of a cell, and one more to the goal; the straight way is
    # four cells.
    assert measures.walked.tolist() == [4 * 128, 8 * 128]
    assert measures.optimum.tolist() == pytest.approx([4 * 128, 4 * 128])
    # The first leg alone: optimum / max(walked, optimum) = 4 / 4.
    assert success_weighted_by_length(measures).tolist() == [1.0]
    # (4 / 4 + 8 / 4) / 2.
    assert mean_detour(measures, shortest=128.0) == pytest.approx(1.5)


def test_the_optimum_goes_around_closed_slots():
    trace = trace_of(AROUND, reached=(7,), closed=True)
    measures = measure_legs(trace, DISTANCES)
    # Half a cell, one cell, a corner cut, three cells, and the same upwards:
    # 64 + 128 + 64 sqrt(2) + 384 + 64 sqrt(2) + 128 + 64 = 949.0.
    around = 768 + 128 * np.sqrt(2)
    assert measures.optimum.tolist() == pytest.approx([around])
    # Corners were not cut: eight cells, 1024.
    assert success_weighted_by_length(measures) == pytest.approx([around / 1024])
    there_and_back = [*AROUND[:-1], *AROUND[:-1][::-1], *AROUND]
    longer = measure_legs(
        trace_of(there_and_back, reached=(21,), closed=True), DISTANCES
    )
    # Twice six cells more, and none from (0, 0) to itself.
    assert longer.walked.tolist() == [(12 + 8) * 128]
    spl = success_weighted_by_length(longer)
    assert spl == pytest.approx([around / (20 * 128)])


def test_an_episode_without_success_has_no_spl_and_no_detour():
    measures = measure_legs(trace_of(STRAIGHT), DISTANCES)
    assert success_weighted_by_length(measures).tolist() == [0.0]
    assert np.isnan(mean_detour(measures, shortest=128.0))


@given(st.lists(st.integers(1, 400) | st.just(-1), min_size=1, max_size=20))
def test_success_grows_with_time_up_to_all_that_ever_succeeded(first):
    share = success_within(first, np.arange(401))
    assert (np.diff(share) >= 0).all()
    assert share[0] == 0.0
    assert share[-1] == pytest.approx(np.mean(np.array(first) > 0))


def test_cuts_are_judged_by_the_truth():
    # Waypoints: before and behind the slot, one far away from both, its neighbour, and
    # one beside the first.
    waypoints = DISTANCES.centres([(0, 1), (0, 3), (2, 2), (2, 1), (0, 0)])
    cuts = {"cut_from": [0, 2, 2, 0, -1], "cut_to": [1, 0, 3, 4, -1]}
    shut = trace_of([(0, 1)] * 5, closed=True, **cuts)
    verdicts = judge_cuts(shut, DISTANCES, waypoints).verdict.tolist()
    # The last edge leads back from the slot, but from where the goal is cut off.
    assert verdicts == ["blockage", "false_edge", "false_block", "blockage"]
    # With the slot open there is no blockage: two cells apart is no false edge.
    free = trace_of([(0, 1)] * 5, closed=False, **cuts)
    verdicts = judge_cuts(free, DISTANCES, waypoints).verdict.tolist()
    assert verdicts == ["false_block", "false_edge", "false_block", "false_block"]


def test_a_cut_far_from_the_slot_is_no_blockage():
    # A longer ring: from (0, 1) and (0, 3), the goal at (0, 8) lies behind the slot at
    # (0, 5), four and two cells away; the edges lead one cell on.
    ring = torch.ones(3, 9, dtype=torch.bool)
    ring[1, 1:-1] = False
    distances = GroundTruthDistances(ring, cell_size=128.0, slot_cells=[(0, 5)])
    waypoints = distances.centres([(0, 1), (0, 2), (0, 3), (0, 4)])
    trace = trace_of(
        [(0, 1)] * 2, goal=(0, 8), closed=True, cut_from=[0, 2], cut_to=[1, 3]
    )
    verdicts = judge_cuts(trace, distances, waypoints).verdict.tolist()
    assert verdicts == ["false_block", "blockage"]


def test_an_edge_into_the_closed_slot_is_a_blockage():
    waypoints = DISTANCES.centres([(0, 1), SLOT])
    trace = trace_of([(0, 1)], closed=True, cut_from=[0], cut_to=[1])
    assert judge_cuts(trace, DISTANCES, waypoints).verdict.tolist() == ["blockage"]


def test_detection_delay_counts_from_standing_before_the_slot():
    waypoints = DISTANCES.centres([(0, 1), (0, 3)])
    # Two cells away at decision 0, one cell away from 1 on, and cut at 5 and again.
    cells = [(0, 0)] + [(0, 1)] * 6
    nothing = [-1] * 5
    trace = trace_of(
        cells, closed=True, cut_from=[*nothing, 0, 0], cut_to=[*nothing, 1, 1]
    )
    cuts = judge_cuts(trace, DISTANCES, waypoints)
    assert detection_delays(trace, DISTANCES, cuts).tolist() == [4]
    assert detection_delays(trace, DISTANCES, cuts[:0]).tolist() == []


def test_each_decision_has_the_first_fault_that_fits():
    waypoints = DISTANCES.centres([(0, 0), (0, 4), (2, 4), (0, 1)])
    here, goal, opposite, beside = range(4)
    decided = [
        # place, target, goal node, lost
        (-1, -1, -1, True, "lost"),
        (opposite, goal, goal, False, "wrong_place"),
        (here, beside, opposite, False, "controller"),  # two cells from the goal
        (here, beside, here, False, "wrong_goal"),
        (here, goal, goal, False, "false_edge"),
        (beside, -1, goal, False, "homing"),
        (here, beside, goal, False, "controller"),
    ]
    place, target, node, lost, names = zip(*decided, strict=True)
    trace = trace_of(
        [(0, 0)] * len(decided), place=place, target=target, goal_node=node, lost=lost
    )
    faults = classify_decisions(trace, DISTANCES, waypoints)
    assert [FAULTS[fault] for fault in faults[0]] == list(names)


def test_slow_legs_count_by_what_took_most_of_them():
    lost, controller = FAULTS.index("lost"), FAULTS.index("controller")
    trace = trace_of([(0, 0)] * 9, reached=(3,))
    faults = np.array([[lost, lost, lost, controller] + [controller] * 5])
    # Legs of 4 and 5 decisions.
    assert slow_legs(trace, faults, limit=3)["lost"] == 1
    assert slow_legs(trace, faults, limit=3)["controller"] == 1
    assert sum(slow_legs(trace, faults, limit=4).values()) == 1
    assert sum(slow_legs(trace, faults, limit=5).values()) == 0


def test_a_trace_is_read_from_a_tensordict_with_and_without_a_navigator():
    truth = {
        "position": torch.rand(2, 3, 2),
        "heading": torch.rand(2, 3, 1),
        "cell": torch.ones(2, 3, 2).long(),
        "goal_cell": torch.ones(2, 3, 2).long(),
        "blocked": torch.ones(2, 3, 1).bool(),
    }
    paid = torch.tensor([[[0.0], [10.0], [0.0]]] * 2)
    after = {"reward": paid, "privileged": {"respawned": paid > 0}}
    data = TensorDict({"privileged": truth, "next": after}, [2, 3])
    trace = trace_navigation(data)
    assert (len(trace), trace.decisions) == (2, 3)
    assert trace.reward[0].tolist() == [0, 10, 0]
    assert trace.reached[1].tolist() == [False, True, False]
    assert (trace.place == -1).all()
    assert not trace.lost.any()
    data["navigation"] = {"place": torch.full((2, 3, 1), 7)}
    assert (trace_navigation(data).place == 7).all()
    with pytest.raises(ValueError, match=r"episodes must be \[N, T\], got \(3,\)"):
        trace_navigation(data[0])


def test_arrays_of_a_trace_must_fit():
    with pytest.raises(ValueError, match=r"must begin with one \[N, T\]"):
        trace_of(STRAIGHT, place=[1, 2])


def test_goal_views_are_near_the_middle_and_look_everywhere():
    middle = DISTANCES.centres([(0, 0)])[0]
    away = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [50.0, 0.0], [0.0, -30.0]])
    looking = [0.0, 90, 180, 270, 350]
    # A degree off counts like a map unit away. East: 0 and 0 off; north: 10; west: 10;
    # south: 50 away, against 90 degrees off in the middle and 80 + 30 for the last.
    places = [(0, 0), (2, 4)]
    chosen = pick_goal_views(middle + away, looking, places, DISTANCES, num_views=4)
    assert chosen[0].tolist() == [0, 1, 2, 3]
    assert chosen[1].tolist() == [-1] * 4


def test_goal_views_do_not_come_through_walls():
    # The middle of the lower side lies 256 units from the slot, and six cells on foot.
    taken = DISTANCES.centres([(2, 2)])
    assert pick_goal_views(taken, [0.0], [SLOT], DISTANCES, reach=3.0)[0, 0] == -1
