"""Collecting processes that die or hang, while they start and while they work."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import psutil
import pytest
from tensordict import TensorDict
from torchrl.envs import EnvBase

from tests.composed import settings
from tests.envs.layouts import LANE
from toponav.builders import (
    CollectionError,
    collect_batches,
    collect_frames,
    processes,
)
from toponav.collectors import patience
from toponav.config import PretrainConfig
from toponav.envs import DEFAULT_ENGINE, MazeEnv, load_engine
from toponav.worlds import WorldSpec


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def hang() -> None:
    time.sleep(1000)


class Misfortune(MazeEnv):
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


def take_all(config: PretrainConfig, *worlds: UnluckyWorld) -> None:
    with collect_frames(config, worlds) as batches:
        for _ in batches:
            pass


#: Death is seen at once; who hangs need not have begun, on a busy machine.
PATIENCE = {die: 120, hang: 8}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "sentence"),
    [(die, "must live as long as.*got: (?!nothing came)"), (hang, "came in 8 s")],
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
        f"collect.max_idle_s={PATIENCE[then]}",
    )
    world = UnluckyWorld(then, while_it_starts)
    begin = time.monotonic()
    with pytest.raises(CollectionError, match=sentence):
        take_all(config, world)
    assert time.monotonic() - begin < 100
    assert_no_process_is_left()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "sentence"),
    [(die, "(process failed: worker 0|one of them died)"), (hang, "came in 8 s")],
)
def test_one_of_two_is_missed_while_the_other_delivers(
    then: Callable[[], None], sentence: str
) -> None:
    config = settings(
        "pretrain",
        "scale=smoke",
        "collect.envs=2",
        "collect.batch=16",
        f"collect.max_idle_s={PATIENCE[then]}",
    )
    begin = time.monotonic()
    with pytest.raises(CollectionError, match=sentence):
        take_all(config, UnluckyWorld(then, False), UnluckyWorld(int, False))
    assert time.monotonic() - begin < 100
    assert_no_process_is_left()


class Queue:
    """A collector whose processes deliver after so many seconds, in this order."""

    num_workers = 2
    maker: int | None = None

    def __init__(self, makers: Sequence[int], seconds: float) -> None:
        self.makers, self.seconds = makers, seconds

    def __iter__(self) -> Iterator[TensorDict]:
        for maker in self.makers:
            time.sleep(self.seconds)
            self.maker = maker
            yield TensorDict()


def test_a_process_that_others_overtake_for_too_long_hangs() -> None:
    with pytest.raises(CollectionError, match=r"nothing came in 0.1 s"):
        list(collect_batches(Queue([0, 1, *[0] * 20], 0.02), max_idle_s=0.1))


def test_a_caller_that_is_busy_does_not_take_a_process_for_one_that_hangs() -> None:
    # A second in all, of which each process could wait for half at most.
    batches = collect_batches(Queue([0, 1, 0, 1, 1, 0, 1, 0], 0), max_idle_s=0.6)
    for _ in range(8):
        next(batches)
        time.sleep(0.25)


class Clock:
    """Stands in for the module ``time``: hours go by at once, as after Ctrl-Z."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


class StoppedQueue(Queue):
    """One whose user stops all of it while a batch is on its way."""

    clock = Clock()

    def __iter__(self) -> Iterator[TensorDict]:
        time.sleep(1.5)
        self.clock.now += 3600
        time.sleep(1.5)
        yield TensorDict()


def test_processes_that_were_stopped_with_all_of_the_run_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    killed, queue = [], StoppedQueue([0], 0)
    for module in (processes, patience):
        monkeypatch.setattr(module, "time", queue.clock)
    monkeypatch.setattr(processes, "_kill_children", lambda: killed.append(1))
    next(collect_batches(queue, max_idle_s=60))
    assert not killed


def test_one_that_was_stopped_in_its_work_may_be_overtaken_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(processes, "time", clock)
    batches = collect_batches(Queue([0, 1, 0, 0, 1], 0), max_idle_s=60)
    for number in range(5):
        next(batches)
        clock.now += 3600 if number == 1 else 1


def assert_no_process_is_left() -> None:
    left = psutil.Process().children(recursive=True)
    assert not [one for one in left if "spawn_main" in " ".join(one.cmdline())]
