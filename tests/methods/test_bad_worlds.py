"""What is no world to explore is one sentence, before anything of a run starts."""

import importlib.util

import gymnasium
import pytest
from hydra.errors import HydraException

from tests.envs.test_pixel_world import PICTURE, VECTOR, Odd
from tests.exploring import explore_settings
from toponav.config import SettingsError
from toponav.envs import EngineError
from toponav.methods import make_world
from toponav.refusals import sentence_of

CONTINUOUS = "ContinuousPictures-v0"


@pytest.fixture(scope="module", autouse=True)
def registered():
    gymnasium.register(CONTINUOUS, lambda: Odd(PICTURE, VECTOR))
    yield
    del gymnasium.registry[CONTINUOUS]


@pytest.mark.parametrize(
    ("id", "sentence"),
    [
        ("NoSuchWorld-v0", "must name a Gymnasium environment"),
        ("no_such_module:World-v0", "No module named 'no_such_module'"),
        ("CartPole-v1", "'CartPole-v1' must be or hold one uint8 picture"),
        (CONTINUOUS, f"the actions of '{CONTINUOUS}' must be discrete"),
    ],
)
def test_an_environment_that_cannot_be_explored(id: str, sentence: str) -> None:
    settings = explore_settings("world=gym", f"world.id='{id}'")
    with pytest.raises(SettingsError) as refusal:
        make_world(settings)
    said = sentence_of(refusal.value, "explore")
    assert said is not None
    assert said.startswith("world.id: ")
    assert sentence in said
    assert "\n" not in said


@pytest.mark.parametrize("option", ["mode:*", "size:[3", "- size:3"])
def test_an_option_that_cannot_be_read(option: str) -> None:
    words = "world=gym", "world.id=CartPole-v1", f"world.options=['{option}']"
    with pytest.raises(SettingsError) as refusal:
        make_world(explore_settings(*words))
    said = sentence_of(refusal.value, "explore")
    rule = "world.options must hold entries such as max_steps:500"
    assert said == f"{rule}, got '{option}'"


def test_an_unknown_world() -> None:
    with pytest.raises(HydraException) as refusal:
        explore_settings("world=gim")
    said = sentence_of(refusal.value, "explore")
    assert said == "world must be one of gym, maze, got 'gim' (did you mean 'gym'?)"


def test_an_engine_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = explore_settings("engine=dmlab")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EngineError) as refusal:
        make_world(settings)
    said = sentence_of(refusal.value, "explore")
    assert said is not None
    assert said.startswith("the DeepMind Lab engine must be installed, and there is no")
