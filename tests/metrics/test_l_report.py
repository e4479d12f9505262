import itertools
import math
from collections import Counter, defaultdict
from dataclasses import replace

import pytest
import torch

from tests.fakes import WORLD
from toponav.metrics import bayes_bound, l_report, useful_actions
from toponav.metrics.l_report import move
from toponav.worlds import Effect, Motion


def test_bound_by_hand():
    # One action: six ends. Two: of 36 ends only forward-backward, its reverse,
    # left-right and its reverse coincide (four ways, one first action right): 33/36.
    # Three and four, by the enumeration below: 171/216 and 930/1296.
    bound = bayes_bound(4, world=WORLD)
    expected = [1, 33 / 36, 171 / 216, 930 / 1296]
    assert bound.tolist() == pytest.approx(expected, abs=1e-9)
    # What the trials found: 1, .92, .79, .71.
    assert bound.tolist() == pytest.approx([1, 0.92, 0.79, 0.71], abs=0.01)


def test_bound_agrees_with_a_walk_tic_by_tic():
    """Four tics a decision, 5 degrees and 8.275 units each, the turn first."""

    def tic_walk(actions):
        x = y = angle = 0.0
        for action in actions:
            turn = {2: 1, 3: -1, 4: 1, 5: -1}.get(action, 0)
            walk = {0: 1, 1: -1, 4: 1, 5: 1}.get(action, 0)
            for _ in range(4):
                angle += 5 * turn
                x += 8.275 * walk * math.cos(math.radians(angle))
                y += 8.275 * walk * math.sin(math.radians(angle))
        return round(x / 4), round(y / 4), angle

    for offset in (1, 2, 3):
        firsts = defaultdict(Counter)
        for actions in itertools.product(range(6), repeat=offset):
            firsts[tic_walk(actions)][actions[0]] += 1
        right = sum(max(count.values()) for count in firsts.values())
        assert float(bayes_bound(3, world=WORLD)[offset - 1]) == pytest.approx(
            right / 6**offset, abs=0.01
        )


def test_bound_agrees_with_all_sequences_one_by_one():
    position, heading = torch.zeros(1, 2).double(), torch.zeros(1).double()
    for _ in range(5):
        position, heading = move(position, heading, world=WORLD)
        position, heading = position.reshape(-1, 2), heading.reshape(-1)
    place = torch.cat([position / 4, heading.unsqueeze(1)], 1).round()
    first = torch.arange(6).repeat_interleave(6**4)
    firsts = defaultdict(Counter)
    for end, action in zip(map(tuple, place.tolist()), first.tolist(), strict=True):
        firsts[end][action] += 1
    right = sum(max(count.values()) for count in firsts.values())
    assert float(bayes_bound(5, world=WORLD)[4]) == pytest.approx(
        right / 6**5, abs=1e-9
    )


def test_coarser_sight_tells_less():
    bounds = [
        bayes_bound(3, world=WORLD, resolution=size)
        for size in (1 / 128, 1 / 32, 1 / 8)
    ]
    assert (bounds[0] >= bounds[1]).all()
    assert bounds[1][2] > bounds[2][2]


def test_moves_by_hand():
    position, heading = move(
        torch.tensor([10.0, 20.0]), torch.tensor(90.0), world=WORLD
    )
    assert heading.tolist() == [90, 90, 110, 70, 110, 70]
    # Forward and left: the chord points 12.5 degrees left of north.
    aside = 33.1 * math.sin(math.radians(12.5))
    north = 33.1 * math.cos(math.radians(12.5))
    expected = [
        [10, 53.1],
        [10, -13.1],
        [10, 20],
        [10, 20],
        [10 - aside, 20 + north],
        [10 + aside, 20 + north],
    ]
    torch.testing.assert_close(position, torch.tensor(expected))


def useful(target, heading, start_heading=0.0):
    mask = useful_actions(
        (torch.zeros(1, 2), torch.tensor([target])),
        (torch.tensor([start_heading]), torch.tensor([heading])),
        world=WORLD,
    )
    return {WORLD.actions[i] for i in mask[0].nonzero().flatten()}


@pytest.mark.parametrize(
    ("target", "heading", "expected"),
    [
        ((100.0, 0.0), 0.0, {"forward"}),
        ((-100.0, 0.0), 0.0, {"backward"}),
        ((0.0, 0.0), 40.0, {"left"}),
        ((0.0, 0.0), 320.0, {"right"}),
        ((0.0, 0.0), 0.0, set()),
        (
            (100.0, 30.0),
            60.0,
            # Right costs a turn and walking pays nearly one step; with forward and
            # right the gap falls from 104.4 to 77.6 units, .81 steps: not enough.
            {"forward", "left", "forward+left"},
        ),
    ],
)
def test_useful_actions_lead_closer(target, heading, expected):
    assert useful(target, heading) == expected


def test_usefulness_turns_with_the_walker():
    # The same scene, turned by 90 degrees.
    assert useful((100.0, 30.0), 60.0) == useful((-30.0, 100.0), 150.0, 90.0)


def test_action_taken_is_always_useful_one_decision_apart():
    position, heading = move(torch.tensor([0.0, 0.0]), torch.tensor(30.0), world=WORLD)
    start = (torch.zeros(6, 2), torch.full((6, 1), 30.0))
    mask = useful_actions((start[0], position), (start[1], heading), world=WORLD)
    assert mask.diagonal().all()


def test_report_by_hand():
    # Offset 1: two pairs, one right; offset 2: none; offset 3: one, wrong.
    logits = torch.full((3, 6), -30.0)
    logits[0, 0] = logits[1, 1] = 30.0
    logits[2, :2] = 0.0
    mask = torch.zeros(3, 6, dtype=torch.bool)
    mask[0, :3] = True  # best useful, taken useful
    mask[1, 2] = True  # best useless, taken useful
    mask[2, 1] = True  # best (0) useless, half the chance useful, taken useless
    report = l_report(
        logits,
        torch.tensor([0, 2, 5]),
        torch.tensor([1, 1, 3]),
        mask,
        max_action_distance=3,
    )
    assert report.count.tolist() == [2, 0, 1]
    nan = math.nan
    for values, expected in [
        (report.accuracy, [0.5, nan, 0]),
        (report.useful_argmax, [0.5, nan, 0]),
        (report.useful_sampled, [0.5, nan, 0.5]),
        (report.useful_taken, [1, nan, 0]),
        (report.useful_uniform, [(3 + 1) / 12, nan, 1 / 6]),
    ]:
        assert values.tolist() == pytest.approx(expected, nan_ok=True)
    assert report.numbers()["useful_sampled_3"] == pytest.approx(0.5)


def test_order_of_the_pairs_is_of_no_matter():
    generator = torch.Generator().manual_seed(0)
    logits = torch.randn(50, 6, generator=generator)
    action = torch.randint(6, (50,), generator=generator)
    offset = torch.randint(1, 5, (50,), generator=generator)
    mask = torch.rand(50, 6, generator=generator) < 0.4
    order = torch.randperm(50, generator=generator)
    one = l_report(logits, action, offset, mask).numbers()
    two = l_report(logits[order], action[order], offset[order], mask[order]).numbers()
    assert one == pytest.approx(two)


def test_bad_pairs_are_refused():
    mask = torch.ones(1, 6, dtype=torch.bool)
    action = torch.tensor([0])
    with pytest.raises(ValueError, match=r"offset must lie in 1\.\.4, got 5 to 5"):
        l_report(torch.zeros(1, 6), action, torch.tensor([5]), mask)
    with pytest.raises(ValueError, match="logits must be numbers, got NaN"):
        l_report(torch.full((1, 6), torch.nan), action, torch.tensor([1]), mask)


def test_other_worlds_move_otherwise():
    world = replace(
        WORLD,
        actions=("spin", "ahead", "hop"),
        motion=Motion(
            cell_size=10, effects=(Effect(turn=90.0), Effect(10.0), Effect(left=3.0))
        ),
    )
    position, heading = move(torch.zeros(2), torch.tensor(90.0), world=world)
    expected = torch.tensor([[0.0, 0.0], [0.0, 10.0], [-3.0, 0.0]])
    torch.testing.assert_close(position, expected)
    assert heading.tolist() == [180, 90, 90]


def test_worlds_without_poses_are_refused():
    with pytest.raises(ValueError, match="world must report poses"):
        move(torch.zeros(2), torch.tensor(0.0), world=replace(WORLD, motion=None))


def test_every_action_has_an_effect():
    with pytest.raises(ValueError, match="one of each action, got 6"):
        replace(WORLD, actions=("forward", "jump"))
