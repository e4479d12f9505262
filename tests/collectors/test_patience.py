"""Waiting for others while a machine sleeps or a job is suspended, as by Ctrl-Z."""

import time
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from toponav.collectors import LastingRayCollector, Mailbox, ray_collector

HOUR = 3600.0


class Clock:
    """Stands in for ``time.monotonic``: hours go by at once."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock)
    return clock


def test_a_reader_that_was_stopped_waits_on_for_a_publication(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = {"weight": torch.ones(3)}
    mailbox, mine = Mailbox({"policy": weights}), {"weight": torch.zeros(3)}
    stamp = mailbox._stamps["policy"]
    stamp += 1  # the publisher writes, and was stopped too

    def sleep(_: float) -> None:
        # It goes on a little later than the reader.
        if clock.now > HOUR:
            stamp.add_(1)
        clock.now += HOUR if clock.now == 0 else 0.1

    monkeypatch.setattr(time, "sleep", sleep)
    assert mailbox.pull("policy", mine) == 1
    assert mine["weight"].tolist() == [1, 1, 1]


class SlowRay:
    """A cluster whose calls are done after so many seconds that count."""

    def __init__(self, clock: Clock, seconds: float, *, stops: bool) -> None:
        self.clock, self.left, self.stops = clock, seconds, stops
        self.asked = list[float]()

    def wait(
        self, calls: list[str], *, num_returns: int, timeout: float, fetch_local: bool
    ) -> tuple[list[str], list[str]]:
        assert not fetch_local
        self.asked.append(timeout)
        spent = min(timeout, self.left)
        self.left -= spent
        if self.stops:
            # Ray's clock has gone on, nobody has worked.
            self.left, self.stops, spent = self.left + spent, False, HOUR
        self.clock.now += spent
        done = num_returns if self.left <= 0 else num_returns - 1
        return calls[:done], calls[done:]


def wait_for_two(ray: SlowRay, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    monkeypatch.setattr(ray_collector, "ray", ray)
    collector = SimpleNamespace(max_idle_s=60.0)
    return LastingRayCollector._wait(collector, ["one", "two", "three"], 2)


@pytest.mark.parametrize("stops", [False, True])
def test_calls_on_a_cluster_that_was_suspended_go_on(
    stops: bool, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = SlowRay(clock, 50.0, stops=stops)
    assert wait_for_two(ray, monkeypatch) == ["one", "two"]


def test_calls_that_hang_are_given_up(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(TimeoutError):
        wait_for_two(SlowRay(clock, 90.0, stops=False), monkeypatch)
    assert 60 <= clock.now < 63
