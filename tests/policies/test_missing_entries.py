"""What acts and lacks an entry says so, and what to add."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from tests.refused import refused
from toponav.methods.learners.dqn import StackedQNetwork
from toponav.policies import FrontierExpert, PathFollower
from toponav.worlds import Effect, Motion, WorldSpec


@pytest.mark.parametrize("kind", [PathFollower, FrontierExpert])
def test_an_expert_names_the_truth_that_is_missing(kind: type) -> None:
    motion = Motion(
        cell_size=10, effects=(Effect(2.5), Effect(turn=20), Effect(turn=-20))
    )
    world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
    expert = kind(torch.ones(1, 3, dtype=torch.bool), world=world)
    said = refused(partial(expert, TensorDict(batch_size=[1])))
    assert "add MazeEnv(privileged=True)" in said


def test_a_network_names_the_state_that_is_missing() -> None:
    network = StackedQNetwork(6, size=36, frames=4, hidden=16)
    said = refused(partial(network, TensorDict(batch_size=[1])))
    assert "add the policy's make_tensordict_primer()" in said
