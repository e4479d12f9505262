"""Few waypoints for all views."""

import numpy as np
from hypothesis import given, strategies as st

from toponav.graph.poses import choose_waypoints, decisions_apart, nearest_waypoints

LIMITS = {"within": 4.0, "above": 0.6, "turn": 20.0}


def same(one, other):
    return np.ones(len(one))


coordinate = st.floats(-20, 20)


@given(
    st.lists(
        st.tuples(coordinate, coordinate, st.floats(0, 360)), min_size=1, max_size=30
    )
)
def test_each_view_has_a_waypoint_nearby_and_waypoints_are_apart(rows) -> None:
    poses = np.array(rows)
    chosen = choose_waypoints(poses, same, **LIMITS)
    apart = decisions_apart(poses[:, None], poses[chosen], 20.0)
    assert (apart.min(1) <= 4.0).all()
    between = decisions_apart(poses[chosen][:, None], poses[chosen], 20.0)
    assert (between[~np.eye(len(chosen), dtype=bool)] > 4.0).all()
    near = nearest_waypoints(poses, poses[chosen], same, **LIMITS)
    assert (near == apart.argmin(1)).all()


def test_a_wall_between_two_places_keeps_them_apart() -> None:
    # Two places three steps apart, from which different things are seen; the last view
    # is nearer to the second, and sees what is seen from the first.
    poses = np.array([[0.0, 0, 0], [3.0, 0, 0], [1.6, 0, 0]])
    side = np.array([0, 1, 0])

    def alike(one, other):
        return (side[one] == side[other]).astype(float)

    chosen = choose_waypoints(poses, alike, **LIMITS)
    assert chosen.tolist() == [0, 1]
    near = nearest_waypoints(
        poses, poses[chosen], lambda one, other: alike(one, chosen[other]), **LIMITS
    )
    assert near.tolist() == [0, 1, 0]


def test_views_without_a_waypoint_are_nowhere() -> None:
    views = np.array([[0.0, 0, 0], [4.1, 0, 0], [np.nan, 0, 0]])
    near = nearest_waypoints(views, np.zeros((1, 3)), same, **LIMITS)
    assert near.tolist() == [0, -1, -1]
