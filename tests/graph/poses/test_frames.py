"""Poses: how far apart, and where actions lead."""

import numpy as np
import torch
from hypothesis import given, strategies as st

from toponav.graph.poses import decisions_apart, moved

poses = st.tuples(*[st.floats(-50, 50) for _ in range(2)], st.floats(-720, 720))


@given(poses, poses)
def test_tensors_and_arrays_are_equally_far_apart(one, other) -> None:
    array = decisions_apart(np.array(one), np.array(other), 20.0)
    tensor = decisions_apart(
        torch.tensor(one, dtype=torch.float64),
        torch.tensor(other, dtype=torch.float64),
        20.0,
    )
    assert abs(float(array) - float(tensor)) < 1e-9
    # At most half a turn, 180 / 20 decisions, beside the steps.
    steps = np.hypot(one[0] - other[0], one[1] - other[1])
    assert steps - 1e-9 <= float(array) <= steps + 9 + 1e-9


def test_an_action_leads_where_the_agent_looks() -> None:
    here = torch.tensor([[1.0, 2.0, 180.0], [0.0, 0.0, 90.0]])
    effects = torch.tensor([[2.0, 0.0, 0.0], [0.0, 1.0, -20.0]])
    # Two steps to the west; looking north, one step to the left is one to the west.
    wanted = [[-1.0, 2.0, 180.0], [-1.0, 0.0, 70.0]]
    torch.testing.assert_close(moved(here, effects), torch.tensor(wanted))


@given(poses, st.floats(-2, 2), st.floats(-2, 2), st.floats(-90, 90))
def test_back_and_forth_ends_where_it_began(pose, ahead, left, turn) -> None:
    start = torch.tensor(pose, dtype=torch.float64)
    go = torch.tensor([ahead, left, 0.0], dtype=torch.float64)
    spin = torch.tensor([0.0, 0.0, turn], dtype=torch.float64)
    end = moved(moved(moved(moved(start, go), spin), -spin), -go)
    torch.testing.assert_close(end, start, atol=1e-9, rtol=0)
