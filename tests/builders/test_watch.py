"""Collecting processes that die or hang, while they start and while they work."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import psutil
import pytest
from torchrl.envs import EnvBase

from tests.envs.layouts import LANE
from tests.test_conf import settings
from toponav.builders import CollectionError, collect_frames
from toponav.config import PretrainConfig
from toponav.envs import DEFAULT_ENGINE, DoomMazeEnv, load_engine
from toponav.worlds import WorldSpec


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def hang() -> None:
    time.sleep(1000)


class Misfortune(DoomMazeEnv):
    """A maze in which something happens in a step."""

    def __init__(self, then: Callable[[], None], **kwargs: object) -> None:
        super().__init__(LANE, **kwargs)
        self.then, self.steps = then, 0

    def _step(self, tensordict):
        self.steps += 1
        if self.steps > 40:
            self.then()
        return super()._step(tensordict)


@dataclass
class UnluckyWorld:
    """Mazes of a process to which something happens."""

    then: Callable[[], None]
    while_it_starts: bool
    name: str = "unlucky"

    @property
    def spec(self) -> WorldSpec:
        return load_engine(DEFAULT_ENGINE).world

    def make_env(self, *, batch_size: int, seed: int) -> EnvBase:
        env = Misfortune(self.then, batch_size=batch_size, seed=seed)
        if self.while_it_starts:
            # Its engines hold the pipe on which the other process waits.
            self.then()
        return env


def take_all(config: PretrainConfig, world: UnluckyWorld) -> None:
    with collect_frames(config, [world]) as batches:
        for _ in batches:
            pass


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "sentence"),
    [(die, "must live as long as"), (hang, r"nothing came in 15 s")],
)
@pytest.mark.parametrize("while_it_starts", [True, False])
def test_it_is_one_sentence_and_no_process_is_left(
    then: Callable[[], None], sentence: str, while_it_starts: bool
) -> None:
    config = settings(
        "pretrain",
        "scale=smoke",
        "collect.envs=2",
        "collect.batch=64",
        "collect.max_idle_s=15",
    )
    world = UnluckyWorld(then, while_it_starts)
    begin = time.monotonic()
    with pytest.raises(CollectionError, match=sentence):
        take_all(config, world)
    assert time.monotonic() - begin < 60
    left = psutil.Process().children(recursive=True)
    assert not [one for one in left if "spawn_main" in " ".join(one.cmdline())]
