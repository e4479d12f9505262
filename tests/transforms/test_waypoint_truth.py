from functools import partial

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from torchrl.data import Binary
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.transforms import Transform

from tests.checks import check_transform
from tests.fakes import FakeMaze
from tests.transforms.colour_world import reset, step
from toponav.keys import HEADING, IS_NEW_WAYPOINT, POSITION, SPURIOUS_WAYPOINT
from toponav.transforms import WaypointTruth

NEAR = 96.0


def at(*poses, is_new_waypoint=True):
    """Envs at x, y and heading; one flag for all, or one each."""
    x, y, heading = torch.tensor(poses, dtype=torch.float32).unbind(-1)
    flags = (
        is_new_waypoint
        if isinstance(is_new_waypoint, list)
        else [is_new_waypoint] * len(poses)
    )
    return TensorDict(
        {
            POSITION: torch.stack([x, y], -1),
            HEADING: heading.unsqueeze(-1),
            IS_NEW_WAYPOINT: torch.tensor(flags).unsqueeze(-1),
        },
        [len(poses)],
    )


def false(data):
    return data[SPURIOUS_WAYPOINT].squeeze(-1).tolist()


@pytest.mark.parametrize(
    ("pose", "known"),
    [
        ((96, 0, 0), True),
        ((96.1, 0, 0), False),
        ((60, 80, 0), False),  # 100 units away
        ((57, 76, 0), True),  # 95
        ((0, 0, 45), True),
        ((0, 0, 45.5), False),
        ((0, 0, 315), True),
        ((0, 0, 314.5), False),
        ((0, 0, 180), False),
    ],
)
def test_near_and_the_same_way(pose, known):
    truth = WaypointTruth(NEAR)
    assert false(reset(truth, at((0, 0, 0)))) == [False]
    assert false(step(truth, at(pose))) == [known]


def test_headings_meet_at_north_of_360():
    truth = WaypointTruth(NEAR)
    reset(truth, at((0, 0, 350)))
    assert false(step(truth, at((0, 0, 30)))) == [True]
    truth = WaypointTruth(NEAR, angle=30)
    reset(truth, at((0, 0, 350)))
    assert false(step(truth, at((0, 0, 30)))) == [False]


def test_only_new_waypoints_are_judged_and_kept():
    truth = WaypointTruth(NEAR)
    reset(truth, at((0, 0, 0)))
    assert false(step(truth, at((0, 0, 0), is_new_waypoint=False))) == [False]
    step(truth, at((500, 0, 0), is_new_waypoint=False))
    assert false(step(truth, at((500, 0, 0)))) == [False]
    assert false(step(truth, at((500, 0, 0)))) == [True]


def test_a_new_episode_forgets_only_the_rows_that_restart():
    truth = WaypointTruth(NEAR)
    reset(truth, at((0, 0, 0), (0, 0, 0)))
    # Rows that go on may be shown anything.
    reset(truth, at((900, 0, 0), (900, 0, 0)), [True, False])
    assert false(step(truth, at((0, 0, 0), (0, 0, 0)))) == [False, True]
    assert false(step(truth, at((900, 0, 0), (900, 0, 0)))) == [True, False]


def test_an_env_with_fewer_waypoints_reads_none_that_are_not_its_own():
    truth = WaypointTruth(NEAR)
    reset(truth, at((900, 0, 0), (900, 0, 0)))
    step(truth, at((300, 0, 0), (0, 0, 0), is_new_waypoint=[True, False]))
    # The second env has none at 0, the first none at 900 since its reset.
    assert false(step(truth, at((600, 0, 0), (0, 0, 0)))) == [False, False]
    reset(truth, at((0, 0, 0), (0, 0, 0)), [True, False])
    assert false(step(truth, at((300, 0, 0), (0, 0, 0)))) == [False, True]


@settings(max_examples=25, deadline=None)
@given(
    way=st.lists(
        st.tuples(st.integers(0, 400), st.integers(0, 400), st.integers(0, 359)),
        min_size=2,
        max_size=40,
    ),
    data=st.data(),
)
def test_it_says_what_a_look_at_all_earlier_waypoints_says(way, data):
    new_waypoints = [True, *(data.draw(st.booleans()) for _ in way[1:])]
    truth = WaypointTruth(NEAR)
    reset(truth, at(way[0]))
    for number in range(1, len(way)):
        x, y, heading = way[number]
        near = any(
            (x - a) ** 2 + (y - b) ** 2 <= 96**2
            and min((heading - h) % 360, (h - heading) % 360) <= 45
            for (a, b, h), is_new_waypoint in zip(
                way[:number], new_waypoints, strict=False
            )
            if is_new_waypoint
        )
        found = step(truth, at(way[number], is_new_waypoint=new_waypoints[number]))
        assert false(found) == [near and new_waypoints[number]]


def test_its_memory_is_bounded():
    truth = WaypointTruth(NEAR)
    for _ in range(20):
        reset(truth, at((0, 0, 0)))
        for decision in range(1, 30):
            is_new_waypoint = decision % 10 == 0
            pose = at((decision * 90, 0, 0), is_new_waypoint=is_new_waypoint)
            assert false(step(truth, pose)) == [False]
    assert truth.poses.shape[1] <= 8


def test_state_dict_goes_on_where_it_was_saved():
    saved, loaded = WaypointTruth(NEAR), WaypointTruth(NEAR)
    reset(saved, at((0, 0, 0), (0, 0, 0)))
    step(saved, at((300, 0, 0), (0, 300, 0)))
    loaded.load_state_dict(saved.state_dict())
    for pose, known in (((300, 0, 0), [True, False]), ((0, 0, 0), [True, True])):
        assert false(step(saved, at(pose, pose))) == known
        assert false(step(loaded, at(pose, pose))) == known


class EverySecond(Transform):
    """Says that every view of an even number of units east is a new waypoint."""

    def _call(self, next_tensordict):
        is_new_waypoint = next_tensordict.get(POSITION)[..., :1].long() % 2 == 0
        return next_tensordict.set(IS_NEW_WAYPOINT, is_new_waypoint)

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec):
        shape = (*observation_spec.shape, 1)
        observation_spec[IS_NEW_WAYPOINT] = Binary(1, shape=shape, dtype=torch.bool)
        return observation_spec


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def make_truth(**arguments):
    return Compose(EverySecond(), WaypointTruth(**{"distance": NEAR} | arguments))


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, make_truth)


def test_specs_hold_for_keys_of_ones_own():
    check_transform(make_maze, partial(make_truth, out_keys=[("truth", "wrong")]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"distance": -1}, "distance must be at least 0 map units, got -1"),
        ({"angle": 200}, r"angle must be in \[0, 180\] degrees, got 200"),
        ({"in_keys": ["a"]}, "in_keys must be 3 and out_keys 1"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        WaypointTruth(**{"distance": NEAR} | arguments)


def test_without_new_waypoints_the_specs_are_refused():
    with pytest.raises(
        ValueError, match="'is_new_waypoint' must be an observation of the env"
    ):
        TransformedEnv(FakeMaze(), WaypointTruth(NEAR)).observation_spec  # noqa: B018
