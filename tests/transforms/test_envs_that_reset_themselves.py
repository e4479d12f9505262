"""Envs that begin the next episode in the step that ends one, by TorchRL's transforms.

``VecGymEnvTransform`` follows gymnasium's vector envs, ``AutoResetTransform`` any env
that is made with ``auto_reset=True``. What most of them hand over as the last view of
an episode is no view of it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import (
    Compose,
    EnvBase,
    GymEnv,
    GymWrapper,
    RenameTransform,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.transforms import Transform

from tests.transforms.test_steps_without_a_reset import PARTS
from toponav import keys
from toponav.methods.rewards.grey_stack import GreyStack
from toponav.methods.rewards.icm import CuriosityReward
from toponav.transforms import PreviousAction, PreviousReward

VIEW = spaces.Box(0, 255, (4, 4, 3), np.uint8)
#: Decisions of an episode in each env; never do all of them end at once.
LENGTHS = [2, 3]
STEPS = 5


def no_network(*stacks: Tensor) -> tuple[Tensor, Tensor]:
    return torch.zeros(()), torch.zeros(stacks[0].shape[:-3])


#: Made for envs of gymnasium, which have no ground truth.
READERS: dict[str, Callable[[], Transform]] = {
    "WaypointMemory": PARTS["WaypointMemory"],
    "NoisyTV": PARTS["NoisyTV"],
    "GreyStack": lambda: GreyStack((4, 4), 3),
}
ALL = READERS | PARTS | {"CuriosityReward": lambda: CuriosityReward(no_network, 1.0)}
DISABLED, SAME, NEXT = (
    AutoresetMode.DISABLED,
    AutoresetMode.SAME_STEP,
    AutoresetMode.NEXT_STEP,
)


class Walk(gymnasium.Env[Any, Any]):
    """An episode of so many decisions; its views tell env, episode and decision."""

    action_space = spaces.Discrete(3)

    def __init__(self, length: int, *, named: bool) -> None:
        self.length, self.named, self.episode = length, named, -1
        self.observation_space = spaces.Dict(pixels=VIEW) if named else VIEW

    def _see(self) -> Any:
        value = 40 * self.decisions + 7 * self.episode + 3 * self.length
        view = np.full((4, 4, 3), value % 256, np.uint8)
        return {"pixels": view} if self.named else view

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        self.decisions, self.episode = 0, self.episode + 1
        return self._see(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.decisions += 1
        return self._see(), 1.0, self.decisions == self.length, False, {}


def make_walks(*, named: bool) -> tuple[list[Walk], list[Callable[[], Walk]]]:
    walks = [Walk(length, named=named) for length in LENGTHS]
    return walks, [partial(lambda walk: walk, walk) for walk in walks]


class GymEnvInOneProcess(GymEnv):
    """``GymEnv(name, num_envs=...)`` makes an ``AsyncVectorEnv``."""

    mode = NEXT

    def _async_env(self, makers: list[Any]) -> SyncVectorEnv:
        return SyncVectorEnv(makers, autoreset_mode=self.mode)


class GymEnvOfSameSteps(GymEnvInOneProcess):
    mode = SAME


class SelfResetting(GymWrapper):
    """As the documentation of ``AutoResetTransform`` has it."""

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        last = super()._step(tensordict)
        if last[keys.DONE].any():
            last.update(super()._reset().exclude(*self.done_keys))
        return last

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        if tensordict is not None and "_reset" in tensordict:
            return tensordict.exclude("_reset")
        return super()._reset(tensordict)


def vector_env(mode: AutoresetMode, *, named: bool) -> tuple[list[Walk], EnvBase]:
    walks, makers = make_walks(named=named)
    return walks, wrap(SyncVectorEnv(makers, autoreset_mode=mode))


def wrap(env: Any, kind: type[GymWrapper] = GymWrapper, **more: Any) -> EnvBase:
    return kind(env, categorical_action_encoding=True, **more)


def self_resetting() -> EnvBase:
    return wrap(Walk(3, named=True), SelfResetting, auto_reset=True)


def gym_env(kind: type[GymEnv]) -> EnvBase:
    name = "tests/Walk-v0"
    gymnasium.register(name, entry_point=partial(Walk, 3, named=False))
    try:
        return kind(name, num_envs=2, categorical_action_encoding=True)
    finally:
        del gymnasium.registry[name]


def play(walks: list[Walk], env: EnvBase, *parts: Transform) -> TensorDictBase:
    env = TransformedEnv(env, Compose(*parts))
    for walk in walks:
        # TorchRL has played with them to find out what they write.
        walk.episode = -1
    actions = torch.Generator().manual_seed(0)

    def choose(data: TensorDictBase) -> TensorDictBase:
        chosen = torch.randint(3, env.batch_size, generator=actions)
        return data.set(keys.ACTION, chosen)

    return env.rollout(STEPS, choose, break_when_any_done=False)


def play_apart(*parts: Transform) -> TensorDictBase:
    """The same episodes, whose resets are TorchRL's."""
    walks, makers = make_walks(named=True)
    envs = [lambda make=make: wrap(make()) for make in makers]
    return play(walks, SerialEnv(len(envs), envs), *parts)


INPUTS = {
    "PreviousAction": lambda: PreviousAction(3),
    "PreviousReward": lambda: PreviousReward(in_keys=["reward"]),
}


@pytest.mark.parametrize("name", [*READERS, *INPUTS])
@pytest.mark.parametrize("mode", [DISABLED, SAME])
def test_episodes_are_those_of_single_envs_where_their_ends_are_known(
    name: str, mode: AutoresetMode
) -> None:
    make = (READERS | INPUTS)[name]
    # TorchRL finds the last view of a box alone, and only if it is not called pixels.
    called = RenameTransform(["observation"], ["pixels"])
    parts = [make()] if mode is DISABLED else [called, make()]
    data = play(*vector_env(mode, named=mode is DISABLED), *parts)
    expected = play_apart(make())
    assert expected["next", keys.DONE].sum() == 3
    for key in expected.keys(True, True):
        assert torch.equal(data[key], expected[key]), key


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("make", "mode"),
    [
        (lambda: vector_env(SAME, named=True)[1], "SAME_STEP"),
        (partial(gym_env, GymEnvOfSameSteps), "SAME_STEP"),
        (partial(gym_env, GymEnvInOneProcess), "NEXT_STEP"),
    ],
)
def test_vector_envs_whose_last_views_are_lost_are_refused(
    name: str, make: Callable[[], EnvBase], mode: str
) -> None:
    rule = f"autoreset_mode must be DISABLED for {name}, which must see .*, got {mode}"
    with pytest.raises(ValueError, match=rule):
        _ = TransformedEnv(make(), ALL[name]()).output_spec
    with pytest.raises(ValueError, match=rule):
        _ = make().append_transform(ALL[name]()).output_spec


@pytest.mark.parametrize("name", ALL)
def test_auto_reset_is_refused(name: str) -> None:
    rule = f"auto_reset must be False for {name}, which must see .*, got True"
    with pytest.raises(ValueError, match=rule):
        _ = TransformedEnv(self_resetting(), ALL[name]()).output_spec
    with pytest.raises(ValueError, match=rule):
        _ = self_resetting().append_transform(ALL[name]()).output_spec


@pytest.mark.parametrize("name", READERS)
def test_the_first_reset_refuses_it(name: str) -> None:
    env = TransformedEnv(self_resetting(), READERS[name]())
    with pytest.raises(ValueError, match=f"auto_reset must be False for {name}"):
        env.reset()


@pytest.mark.parametrize("name", READERS)
def test_without_an_env_it_says_what_it_writes_all_the_same(name: str) -> None:
    env = vector_env(DISABLED, named=True)[1]
    expected = TransformedEnv(env, READERS[name]()).output_spec
    composed = Compose(READERS[name]()).transform_output_spec(env.output_spec)
    assert composed == expected


@pytest.mark.parametrize("name", ["GreyStack", "CuriosityReward"])
def test_native_autoreset_is_refused(name: str) -> None:
    rule = f"native_autoreset must be False for {name}, which must see .*, got True"
    nothing = TensorDict(batch_size=[2])
    with pytest.raises(ValueError, match=rule):
        ALL[name]()._reset_on_native_autoreset(nothing, nothing)
