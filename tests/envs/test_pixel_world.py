"""Any Gymnasium environment with pictures as a batched world."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from torchrl.envs import EnvBase, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.foreign_world import ForeignWorld
from toponav.envs import make_pixel_env

FOREIGN = "tests.foreign_world:ForeignWorld-v0"


class Odd(gymnasium.Env[Any, Any]):
    """An environment of any spaces; it shows how many steps were taken, then ends."""

    def __init__(
        self, observation: spaces.Space[Any], action: spaces.Space[Any], length: int = 3
    ) -> None:
        self.observation_space, self.action_space = observation, action
        self.length, self.actions = length, []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return self._observe(), {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.count += 1
        return self._observe(), float(action), self.count == self.length, False, {}

    def render(self):
        return None

    def _observe(self):
        space = self.observation_space
        if isinstance(space, spaces.Dict):
            return {key: self._fill(entry) for key, entry in space.spaces.items()}
        return self._fill(space)

    def _fill(self, space):
        return np.full(space.shape, self.count, dtype=space.dtype)


PICTURE = spaces.Box(0, 255, (6, 8, 3), np.uint8)
VECTOR = spaces.Box(-1, 1, (4,), np.float32)
ODD = {
    "Dict-v0": (spaces.Dict({"near": PICTURE, "speed": VECTOR}), spaces.Discrete(2)),
    "Two-v0": (spaces.Dict({"near": PICTURE, "far": PICTURE}), spaces.Discrete(2)),
    "Vector-v0": (VECTOR, spaces.Discrete(2)),
    "Grey-v0": (spaces.Box(0, 255, (6, 8, 1), np.uint8), spaces.Discrete(2)),
    "Float-v0": (spaces.Box(0, 1, (6, 8, 3), np.float32), spaces.Discrete(2)),
    "Continuous-v0": (PICTURE, VECTOR),
    "Offset-v0": (PICTURE, spaces.Discrete(3, start=5)),
}


@pytest.fixture(scope="module", autouse=True)
def registered():
    for name, (observation, action) in ODD.items():
        gymnasium.register(
            f"Odd{name}",
            lambda observation=observation, action=action: Odd(observation, action),
        )
    yield
    for name in ODD:
        del gymnasium.registry[f"Odd{name}"]


def make(id: str = FOREIGN, **options) -> EnvBase:
    settings = {"batch_size": 3, "episode_length": 5, "seed": 0, **options}
    return make_pixel_env(id, **settings)


def test_the_foreign_world_is_a_gymnasium_environment() -> None:
    check_env(ForeignWorld())


def test_the_foreign_world_looks_different_in_every_place() -> None:
    world = ForeignWorld()
    world.reset(seed=0)
    views = set()
    rng = np.random.default_rng(0)
    for _ in range(3000):
        views.add(world.step(rng.integers(4))[0].tobytes())
    assert len(views) > 70


@pytest.mark.parametrize("id", [FOREIGN, "OddDict-v0", "OddOffset-v0"])
def test_specs_hold(id: str) -> None:
    env = make(id)
    check_env_specs(env, break_when_any_done="both")
    check_env_specs(TransformedEnv(env, StepCounter()), break_when_any_done="both")


def test_the_keys_are_those_of_a_world_without_truth() -> None:
    env = make()
    data = env.rollout(3)
    assert set(data["next"].keys(True, True)) == {
        *("pixels", "reward", "done", "terminated", "truncated")
    }
    assert data["pixels"].shape == (3, 3, 48, 64, 3)
    assert data["pixels"].dtype == torch.uint8
    assert data["action"].dtype == torch.int64
    assert env.world.view_size == (48, 64)
    assert env.world.actions == ("north", "south", "west", "east")
    assert not env.world.has_truth
    assert TransformedEnv(env, StepCounter()).world is env.world
    assert make("OddDict-v0").world.actions == ("action 0", "action 1")


def test_the_clock_truncates_and_the_environment_terminates() -> None:
    data = make().rollout(20)["next"]
    assert data.shape == (3, 5)
    assert data["truncated"][:, -1].all()
    assert not data["terminated"].any()
    data = make("OddDict-v0").rollout(20)["next"]
    assert data.shape == (3, 3)
    assert data["terminated"][:, -1].all()
    assert not data["truncated"].any()


def test_the_same_seed_plays_the_same_episodes() -> None:
    env = make(seed=4)

    def play(env: EnvBase, *first: int) -> torch.Tensor:
        """The second episode's start does not depend on what the first one did."""
        data = env.reset()
        for action in first:
            data = env.step(data.set("action", torch.full((3,), action)))["next"]
        return torch.cat([data["pixels"], env.reset()["pixels"]])

    first = play(env, 0)
    assert (play(make(seed=4), 0) == first).all()
    assert (play(make(seed=4), 1, 2)[3:] == first[3:]).all()
    env.set_seed(4)
    assert (play(env, 0) == first).all()
    assert (play(make(seed=5), 0) != first).any()
    # Rows have episodes of their own.
    assert (first[0] != first[1]).any()


def test_a_partial_reset_leaves_the_other_rows_alone() -> None:
    env = make()
    data = env.rollout(2)[:, -1]["next"]
    before = data["pixels"].clone()
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(data.set("_reset", mask))
    assert (after["pixels"][[0, 2]] == before[[0, 2]]).all()
    later = env.rollout(5, auto_reset=False, tensordict=after)["next", "done"]
    # Rows 0 and 2 have gone two decisions, row 1 none.
    assert later.squeeze(-1).tolist() == [
        [False, False, True],
        [False, False, False],
        [False, False, True],
    ]


def test_actions_begin_where_the_space_begins() -> None:
    env = make("OddOffset-v0")
    data = env.reset().set("action", torch.tensor([0, 1, 2]))
    assert env.step(data)["next", "reward"].flatten().tolist() == [5.0, 6.0, 7.0]


@pytest.mark.parametrize(
    ("id", "message"),
    [
        ("tests.foreign_world:Nowhere-v0", "must name a Gymnasium .*'.*Nowhere-v0': "),
        ("no_such_module:World-v0", "got 'no_such_module:World-v0': .*no_such_module"),
        ("OddVector-v0", r"'OddVector-v0' must be or hold one uint8 .*got Box\(-1"),
        ("OddGrey-v0", "must be or hold one uint8 picture"),
        ("OddFloat-v0", "must be or hold one uint8 picture"),
        ("OddTwo-v0", "must be or hold one uint8 picture .*got Dict"),
        ("OddContinuous-v0", "the actions of 'OddContinuous-v0' must be discrete"),
    ],
)
def test_what_is_no_pixel_world_is_refused(id: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        make(id)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["batch_size", "episode_length"])
def test_numbers_below_one_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} .*must be at least 1, got .*0"):
        make(**{name: 0})


def test_an_environment_without_pixels_may_be_rendered() -> None:
    env = make("CartPole-v1", render=True, batch_size=2)
    data = env.rollout(3)
    assert data["pixels"].shape == (2, 3, *env.world.view_size, 3)
    assert (data["pixels"][:, 0] != data["next", "pixels"][:, 0]).any()
    env.close()


def test_an_environment_that_renders_no_picture_is_refused() -> None:
    gymnasium.register(
        "OddBlind-v0", lambda render_mode: Odd(VECTOR, spaces.Discrete(2))
    )
    try:
        with pytest.raises(ValueError, match=r"'OddBlind-v0' must render a picture"):
            make("OddBlind-v0", render=True)
    finally:
        del gymnasium.registry["OddBlind-v0"]
