"""What remembers an episode steps after its reset alone, and in one env alone."""

from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.transforms import Transform

from toponav import keys
from toponav.transforms import (
    Coverage,
    LoopClosure,
    NoisyTV,
    PlacesVisited,
    PreviousReward,
    RandomReward,
    WaypointMemory,
    WaypointTruth,
)


def memory() -> WaypointMemory:
    def compare(one: torch.Tensor, many: torch.Tensor) -> torch.Tensor:
        return (-(one.unsqueeze(-2) - many).norm(dim=-1)).exp()

    def embed(views: torch.Tensor) -> torch.Tensor:
        return views[..., 0, 0, :].float() / 255

    return WaypointMemory(embed, compare, capacity=3, threshold=0.5)


PARTS = {
    "WaypointMemory": memory,
    "Coverage": lambda: Coverage(torch.ones(1, 4, dtype=torch.bool)),
    "WaypointTruth": lambda: WaypointTruth(96.0),
    "PlacesVisited": lambda: PlacesVisited(96.0),
    "LoopClosure": lambda: LoopClosure(near=96.0, far=200.0),
    "NoisyTV": lambda: NoisyTV(size=2, seed=0),
}


def views_of(envs: int) -> TensorDict:
    view = torch.zeros(envs, 4, 4, 3, dtype=torch.uint8)
    entries = {
        keys.PIXELS: view,
        keys.NETWORK_PIXELS: view,
        keys.POSITION: torch.zeros(envs, 2),
        keys.HEADING: torch.zeros(envs, 1),
        keys.CELL: torch.zeros(envs, 2, dtype=torch.int64),
        keys.IS_NEW_WAYPOINT: torch.ones(envs, 1, dtype=torch.bool),
    }
    return TensorDict(entries, [envs])


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("before", [0, 3])
def test_a_step_of_other_envs_is_refused(name: str, before: int) -> None:
    part: Transform = PARTS[name]()
    if before:
        part._reset(TensorDict(batch_size=[before]), views_of(before))
    with pytest.raises(ValueError, match=r"a step must follow a reset of the same env"):
        part._step(TensorDict(batch_size=[2]), views_of(2))
    part._reset(TensorDict(batch_size=[2]), views_of(2))
    part._step(TensorDict(batch_size=[2]), views_of(2))


def elsewhere(envs: int) -> TensorDict:
    """A white view of another cell."""
    data = views_of(envs)
    for key, change in {
        keys.PIXELS: 255,
        keys.POSITION: torch.tensor([300.0, 0.0]),
        keys.CELL: torch.tensor([0, 2]),
    }.items():
        data[key] = data[key] + change
    return data


@pytest.mark.parametrize("name", [*PARTS, "RandomReward"])
def test_a_clone_has_an_episode_of_its_own(name: str) -> None:
    part = RandomReward(0) if name == "RandomReward" else PARTS[name]()
    nothing = TensorDict(batch_size=[2])
    part._reset(nothing, views_of(2))
    part._step(nothing, views_of(2))
    before, copied = deepcopy(part.state_dict()), part.clone()
    torch.testing.assert_close(copied.state_dict(), before, rtol=0, atol=0)
    copied._reset(nothing, elsewhere(2))
    for _ in range(2):
        copied._step(nothing, elsewhere(2))
    torch.testing.assert_close(part.state_dict(), before, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["Coverage", "WaypointTruth", "PlacesVisited"])
def test_ground_truth_that_is_missing_is_named_with_who_gives_it(name: str) -> None:
    part: Transform = PARTS[name]()
    sentence = r"must have .*: add (MazeEnv\(privileged=True\)|WaypointMemory), got"
    with pytest.raises(KeyError, match=sentence):
        part._reset(TensorDict(batch_size=[2]), TensorDict(batch_size=[2]))


def test_the_previous_reward_starts_without_an_env_too() -> None:
    start = TensorDict(batch_size=[2])
    assert PreviousReward()._reset(start, start)["previous_reward"].tolist() == [
        [0.0],
        [0.0],
    ]
