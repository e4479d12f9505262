"""What is done with a Gymnasium environment before it is a world."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torchrl.envs.utils import check_env_specs

from toponav.envs import GymChoices, make_pixel_env

PICTURE = spaces.Box(0, 255, (6, 8, 3), np.uint8)


class Line(gymnasium.Env[Any, Any]):
    """A walker on a line: action 0 stays, 1 goes east, 2 west; it starts anywhere."""

    observation_space = spaces.Dict({"near": PICTURE, "far": PICTURE})
    action_space = spaces.Discrete(3)

    def __init__(self, scale: int = 1) -> None:
        self.scale, self.place = scale, None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = [int(self.np_random.integers(100)), 7]
        return self._observe(), {"body": {"x": 0.5}}

    def step(self, action):
        self.place[0] += (0, 1, -1)[action] * self.scale
        return self._observe(), 0.0, False, False, {"body": {"x": self.place[0] / 2}}

    def _observe(self):
        near = np.full((6, 8, 3), self.place[0], dtype=np.uint8)
        return {"near": near, "far": 255 - near}


class Named(Line):
    """A walker that says what its actions mean."""

    def get_action_meanings(self) -> list[str]:
        return ["stay", "east", "west"]


class Moving(gymnasium.ActionWrapper[Any, Any, Any]):
    """Leaves out the action that stays."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.action_space = spaces.Discrete(2)

    def action(self, action):
        return action + 1


class Darker(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Halves what is near."""

    def observation(self, observation):
        return observation | {"near": observation["near"] // 2}


DARKER = f"{__name__}.Darker"


@pytest.fixture(scope="module", autouse=True)
def registered():
    gymnasium.register("Line-v0", Line)
    gymnasium.register("Named-v0", Named)
    yield
    del gymnasium.registry["Line-v0"], gymnasium.registry["Named-v0"]


def make(id: str = "Line-v0", *, batch_size: int = 2, privileged=False, **choices):
    return make_pixel_env(
        id,
        batch_size=batch_size,
        episode_length=9,
        seed=0,
        choices=GymChoices(**({"view": "near"} | choices)),
        privileged=privileged,
    )


def test_a_wrapper_is_found_by_its_import_path_or_given() -> None:
    plain = make(reset_seed=3).reset()["pixels"]
    halved = make(reset_seed=3, wrappers=[DARKER]).reset()["pixels"]
    twice = make(reset_seed=3, wrappers=[DARKER, Darker]).reset()["pixels"]
    # 81 // 2 = 40, 40 // 2 = 20.
    assert [views.unique().item() for views in (plain, halved, twice)] == [81, 40, 20]


def test_every_reset_may_have_one_seed() -> None:
    env = make(reset_seed=3)
    first, second = env.reset()["pixels"], env.reset()["pixels"]
    assert torch.equal(first, second)
    env = make()
    assert not torch.equal(env.reset()["pixels"], env.reset()["pixels"])


def test_only_the_chosen_actions_are_left() -> None:
    env = make(reset_seed=3, actions=[2, 1], options={"scale": 10})
    assert env.world.actions == ("action 2", "action 1")
    start = env.reset()
    assert start["pixels"][:, 0, 0, 0].tolist() == [81, 81]
    step = env.step(start.set("action", torch.tensor([0, 1])))
    assert step["next", "pixels"][:, 0, 0, 0].tolist() == [71, 91]


def test_actions_have_the_names_that_the_environment_gives_them() -> None:
    assert make("Named-v0").world.actions == ("stay", "east", "west")
    assert make("Named-v0", actions=[2, 1]).world.actions == ("west", "east")


def test_there_are_as_many_actions_as_wrappers_leave() -> None:
    env = make("Named-v0", reset_seed=3, wrappers=[Moving])
    assert env.world.num_actions == env.action_spec.n == 2
    start = env.reset()
    step = env.step(start.set("action", torch.tensor([0, 1])))
    assert step["next", "pixels"][:, 0, 0, 0].tolist() == [82, 80]


def test_the_position_is_privileged_and_there_if_asked_for() -> None:
    where = {"position": ["place.1", "body.x"], "square": 2.5}
    env = make(reset_seed=3, privileged=True, **where)
    check_env_specs(env)
    assert env.world.place_size == 2.5
    start = env.reset()
    step = env.step(start.set("action", torch.tensor([1, 2])))
    assert start["privileged", "position"].tolist() == [[7, 0.5], [7, 0.5]]
    assert step["next", "privileged", "position"].tolist() == [[7, 41], [7, 40]]
    assert "privileged" not in make(**where).reset()
    # One environment is put back, the other stays where it was.
    mask = torch.tensor([[True], [False]])
    again = env.reset(step["next"].clone().set("_reset", mask))
    assert again["privileged", "position"].tolist() == [[7, 0.5], [7, 40]]


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ({"view": None}, r"view=<key> picks one"),
        ({"view": "behind"}, r"view must name .* got 'behind' of far, near"),
        ({"wrappers": ["Darker"]}, "wrappers must be import paths .*got 'Darker'"),
        ({"wrappers": ["no_such.Darker"]}, "wrappers must be .*got 'no_such.Darker'"),
        ({"wrappers": [f"{DARKER}er"]}, "wrappers must be import paths"),
        ({"wrappers": ["os.getcwd"]}, "wrappers must fit the environment, got os"),
        ({"wrappers": [lambda env: 3]}, "wrappers must return an environment"),
        ({"options": {"size": 3}}, "must name a Gymnasium environment.*size"),
        ({"actions": [0, 3]}, "actions must be two or more .*0 to 2, got .0, 3."),
        ({"actions": [1]}, "actions must be two or more"),
        ({"position": ["place.1"]}, "position must be of two numbers"),
        ({"position": ["place.1", "place.2"]}, "position must lead to .*'place.2'"),
        ({"position": ["place", "body"]}, "position must lead to .*'place'"),
    ],
)
def test_what_does_not_fit_is_refused(choices: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make(**choices)


def test_a_world_of_the_extra_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "minigrid", None)
    with pytest.raises(ValueError, match=r"pip install 'toponav\[worlds\]'"):
        make("MiniGrid-Empty-5x5-v0")
