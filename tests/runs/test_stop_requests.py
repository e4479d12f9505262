import os
import signal

import pytest

from toponav.runs import StoppedError, stop_requests

BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def stopped_by(number: int, *, times: int, seen: list[int]) -> None:
    with stop_requests() as stop:
        assert not stop.requested
        for _ in range(times):
            os.kill(os.getpid(), number)
        seen.append(stop.requested)


@BOTH
def test_a_signal_is_noted_and_ends_the_process_after_the_block(number: int) -> None:
    seen: list[int] = []
    with pytest.raises(SystemExit) as end:
        stopped_by(number, times=1, seen=seen)
    assert seen == [number]
    assert end.value.code == 128 + number


@BOTH
def test_the_second_signal_insists(number: int) -> None:
    seen: list[int] = []
    with pytest.raises(SystemExit):
        stopped_by(number, times=2, seen=seen)
    assert seen == []


def test_what_is_said_is_true_of_the_run(capfd: pytest.CaptureFixture[str]) -> None:
    said = []
    for sentences in ([], ["half a table is there"], [None]):
        with pytest.raises(SystemExit), stop_requests(*sentences):
            os.kill(os.getpid(), signal.SIGTERM)
        said.append(capfd.readouterr().err)
    assert said == [
        "stopped; resume=<run folder> continues\n",
        "stopped; half a table is there\n",
        "",
    ]


def checked_after(number: int) -> None:
    with stop_requests() as stop:
        stop.check()
        os.kill(os.getpid(), number)
        with pytest.raises(StoppedError):
            stop.check()


@BOTH
def test_what_is_not_worth_finishing_can_end_at_once(number: int) -> None:
    with pytest.raises(SystemExit) as end:
        checked_after(number)
    assert end.value.code == 128 + number


def test_without_a_signal_the_handlers_are_as_before() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with stop_requests():
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before
