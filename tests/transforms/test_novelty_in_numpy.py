"""The novelty reward in other people's worlds, against a version of it in NumPy."""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d
from torchrl.envs import (
    Compose,
    EnvBase,
    GymWrapper,
    PermuteTransform,
    TransformedEnv,
)

from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
)
from toponav.views import ChannelOrder

THRESHOLD, ALPHA, BETA, FLOOR, CAPACITY = 0.8, 0.3, 0.7, 0.6, 12


def foreign_world() -> gymnasium.Env[Any, Any]:
    return gymnasium.make("tests.foreign_world:ForeignWorld-v0")


def minigrid_world() -> gymnasium.Env[Any, Any]:
    wrappers = pytest.importorskip("minigrid.wrappers")
    world = gymnasium.make("MiniGrid-Playground-v0", max_steps=500)
    return wrappers.ImgObsWrapper(wrappers.RGBImgPartialObsWrapper(world))


def cart_pole() -> gymnasium.Env[Any, Any]:
    """What Gymnasium renders of it, 400 x 600 pixels."""
    world = gymnasium.make("CartPole-v1", render_mode="rgb_array")
    return gymnasium.wrappers.AddRenderObservation(world)


def atari_game() -> gymnasium.Env[Any, Any]:
    games = pytest.importorskip("ale_py", reason="ale-py is not installed (worlds)")
    gymnasium.register_envs(games)
    return gymnasium.make("ALE/MontezumaRevenge-v5")


class World(NamedTuple):
    """A world of others, and by how much its views differ."""

    make: Callable[[], gymnasium.Env[Any, Any]]
    #: What embeddings are multiplied by, so that some views are new and some are not.
    contrast: float = 1.0
    episodes: int = 2


WORLDS = {
    "foreign": World(foreign_world),
    "minigrid": World(minigrid_world),
    "cart_pole": World(cart_pole, 25.0, 8),
    "atari": World(atari_game, 4.0),
}


def make(world: World, channels: ChannelOrder):
    # TorchRL's usual env, with one-hot actions.
    steps = [PermuteTransform([-1, -3, -2], in_keys=["pixels"])]
    steps = steps if channels == "CHW" else []

    def embed(views: Tensor) -> Tensor:
        planes = views if channels == "CHW" else views.movedim(-1, -3)
        # Black, so that what is white in all views adds no rounding.
        black = 1 - planes.float().mean(-3, keepdim=True) / 255
        return world.contrast * adaptive_avg_pool2d(black, (8, 8)).flatten(1)

    def compare(one: Tensor, many: Tensor) -> Tensor:
        return torch.exp(-0.5 * (one.unsqueeze(-2) - many).norm(dim=-1))

    memory = WaypointMemory(
        embed, compare, threshold=THRESHOLD, capacity=CAPACITY, channels=channels
    )
    pay = CountReward(ALPHA), TemporalDistanceReward(BETA, floor=FLOOR)
    transforms = Compose(*steps, memory, *pay, IntrinsicReward())
    env = TransformedEnv(GymWrapper(world.make()), transforms)
    env.set_seed(3)
    torch.manual_seed(3)
    return env


def parts(size: int) -> list[slice]:
    """Eighths of rows or columns; one that they share belongs to both."""
    edges = [size * part / 8 for part in range(9)]
    return [
        slice(int(np.floor(start)), int(np.ceil(stop)))
        for start, stop in itertools.pairwise(edges)
    ]


def in_numpy(pictures: np.ndarray, contrast: float) -> np.ndarray:
    """Rewards of views ``[T + 1, H, W, 3]`` of an episode, ``[T]``, by eqs. 6 to 8."""
    black = 1 - pictures.astype(float).mean(-1) / 255
    rows, columns = (parts(size) for size in black.shape[1:])
    tiles = [black[:, row, column].mean((1, 2)) for row in rows for column in columns]
    codes = contrast * np.stack(tiles, -1)
    waypoints, visits, rewards = [codes[0]], [1], []
    for code in codes[1:]:
        apart = [np.sqrt(((code - known) ** 2).sum()) for known in waypoints]
        similarity = [np.exp(-0.5 * distance) for distance in apart]
        nearest = int(np.argmax(similarity))
        if similarity[nearest] > THRESHOLD:
            visits[nearest] += 1
            rewards.append(ALPHA / np.sqrt(visits[nearest]))
        elif len(waypoints) < CAPACITY:
            waypoints.append(code)
            visits.append(1)
            rewards.append(BETA / max(similarity[nearest], FLOOR))
        else:
            rewards.append(0.0)
    return np.array(rewards)


@pytest.mark.parametrize("channels", ["HWC", "CHW"])
@pytest.mark.parametrize("name", WORLDS)
def test_the_reward_is_that_of_the_equations(name: str, channels: ChannelOrder) -> None:
    world = WORLDS[name]
    env: EnvBase = make(world, channels)
    paid = []
    for _ in range(world.episodes):
        walk = env.rollout(150)
        assert walk["action"].shape == (len(walk), env.action_spec.shape[-1])
        views = torch.cat([walk["pixels"][:1], walk["next", "pixels"]])
        assert views.shape[-3 if channels == "CHW" else -1] == 3
        pictures = views.movedim(-3, -1) if channels == "CHW" else views
        expected = in_numpy(pictures.numpy(), world.contrast)
        found = walk["next", "intrinsic_reward"].flatten().numpy()
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-6)
        paid.append(expected)
    # Every kind of payment occurs: known, new, and none since the memory is full.
    rewards = np.concatenate(paid)
    assert len(rewards) > 100
    assert (rewards == 0).any()
    assert ((rewards > 0) & (rewards <= ALPHA)).any()
    assert (rewards > BETA).any()
