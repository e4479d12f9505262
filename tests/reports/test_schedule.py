import csv
import math
from pathlib import Path

import pytest

from tests.exploring import explore_settings
from toponav.reports import schedule as module
from toponav.reports.schedule import (
    EVALUATE,
    EXPLORE,
    PRETRAIN,
    Schedule,
    explore_schedule,
)


class Clock:
    """Stands in for the module ``time``."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(module, "time", made)
    return made


def test_a_machine_that_took_twice_as_long_will_go_on_so(
    clock: Clock, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    schedule = Schedule({"one": 60.0, "two": 120.0, "three": 60.0}, tmp_path)
    schedule.begin("one")
    clock.now += 120
    schedule.begin("two")
    # 2 x (120 + 60) s are left.
    assert "then three; all done in about 6.0 minutes" in capsys.readouterr().err
    clock.now += 120
    # A third of it took 120 s: 240 s to go. All phases so far took 240 s where
    # 60 + 120 / 3 = 100 were expected: 2.4 x 60 s = 144 s for the last. 384 s.
    capsys.readouterr()
    schedule.show(1 / 3)
    assert capsys.readouterr().err == (
        "phase 2 of 3: two, then three; all done in about 6.4 minutes\n"
    )
    # Once a minute is enough.
    clock.now += 59
    schedule.show(0.5)
    assert capsys.readouterr().err == ""
    clock.now += 1
    schedule.show(1)
    # 180 s and 120 before where 180 were expected: 60 x 300 / 180 s = 1.7 minutes.
    assert capsys.readouterr().err.endswith("all done in about 1.7 minutes\n")
    clock.now -= 60
    schedule.begin("three")
    schedule.end()
    assert schedule.minutes == 4
    with (tmp_path / "phases.csv").open() as file:
        rows = [list(row.values()) for row in csv.DictReader(file)]
    assert rows == [["one", "120", "120"], ["two", "240", "120"], ["three", "240", "0"]]


def test_the_times_of_a_run_that_is_resumed_add_up(
    clock: Clock, tmp_path: Path
) -> None:
    def start(resumed: bool) -> Schedule:
        expected = {"one": 60.0, "two": 60.0}
        return Schedule(expected, tmp_path, announce=False, resumed=resumed)

    def times() -> list[list[str]]:
        with (tmp_path / "phases.csv").open() as file:
            return [list(row.values()) for row in csv.DictReader(file)]

    schedule = start(resumed=False)
    schedule.begin("one")
    clock.now += 100
    schedule.show(0.5)
    # Cut off: nobody knows of the next seconds, nor of those until it is resumed.
    clock.now += 1000
    assert times() == [["one", "100", "100"]]
    schedule = start(resumed=True)
    schedule.begin("one", rest=0.5)
    clock.now += 50
    schedule.begin("two")
    clock.now += 30
    schedule.end()
    assert times() == [["one", "150", "150"], ["two", "180", "30"]]
    assert schedule.minutes == pytest.approx(80 / 60)
    # It goes on with more decisions, and is evaluated again.
    schedule = start(resumed=True)
    schedule.begin("one")
    clock.now += 20
    schedule.begin("two")
    clock.now += 30
    schedule.end()
    assert times() == [["one", "200", "170"], ["two", "230", "60"]]
    # Another run in this folder begins with none; damaged ones are no times.
    start(resumed=False).begin("one")
    for row in (b"one", b"one,5,5,5", b"\0\0\0", b"\xff,5,5", b"1" * 200_000 + b",5,5"):
        (tmp_path / "phases.csv").write_bytes(b"phase,ended,seconds\n" + row + b"\n")
        schedule = start(resumed=True)
        schedule.begin("one")
        schedule.end()
        assert times() == [["one", "0", "0"]]


@pytest.mark.parametrize(("words", "resumed"), [((), "7"), (("resume=run",), "12")])
def test_an_exploration_that_is_resumed_goes_on_with_its_times(
    clock: Clock, tmp_path: Path, words: tuple[str, ...], resumed: str
) -> None:
    (tmp_path / "phases.csv").write_text(f"phase,ended,seconds\n{EXPLORE},5,5\n")
    schedule = explore_schedule(explore_settings("reward=random", *words), tmp_path)
    schedule.begin(EXPLORE)
    clock.now += 7
    schedule.end()
    with (tmp_path / "phases.csv").open() as file:
        assert [row["seconds"] for row in csv.DictReader(file)] == [resumed]


def test_of_parts_that_go_on_beside_each_other_the_last_one_counts(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    schedule = Schedule({"one": 60.0, "two": 160.0})
    schedule.begin("one")
    clock.now += 60
    schedule.begin("two")
    first, second = schedule.part(), schedule.part()
    first(0.0)
    clock.now += 60
    capsys.readouterr()
    # One part is nearly over, nothing is known of the other: 160 - 60 = 100 s.
    first(0.9)
    said = capsys.readouterr().err
    assert said == "phase 2 of 2: two; all done in about 1.7 minutes\n"
    clock.now += 60
    first(1.0)
    # Still nothing: 160 - 120 = 40 s.
    assert capsys.readouterr().err.endswith("all done in about 0.7 minutes\n")
    clock.now += 60
    second(0.5)
    # 0.5 x 180 s by its rate, and more than was expected is over: 1.5 minutes.
    assert capsys.readouterr().err.endswith("all done in about 1.5 minutes\n")
    clock.now += 60
    second(0.9)
    # 0.9 x 240 x 0.1 / 0.9 = 24 s.
    assert capsys.readouterr().err.endswith("all done in about 0.4 minutes\n")
    second(1.0)
    schedule.end()


def test_engines_that_start_do_not_count_as_slow_progress(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    schedule = Schedule({"one": 600.0, "two": 60.0})
    schedule.begin("one")
    capsys.readouterr()
    # The first batch comes after 90 s: nobody knows yet how long others take.
    clock.now += 90
    schedule.show(0.01)
    assert capsys.readouterr().err == ""
    # 40 s for 4 % of it: 950 s for 95 %. All in all 130 + 950 = 1080 s, 1.8 times as
    # long as expected: 108 s for the other phase.
    clock.now += 40
    schedule.show(0.05)
    assert "all done in about 17.6 minutes" in capsys.readouterr().err
    # The next phase counts on its own progress.
    clock.now += 950
    schedule.begin("two")
    assert "all done in about 1.8 minutes" in capsys.readouterr().err
    clock.now += 60
    schedule.show(0.5)
    assert "all done in about 1.0 minutes" in capsys.readouterr().err


def test_a_phase_of_unknown_length_is_said_to_be(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    schedule = Schedule({"one": math.nan, "two": 120.0})
    schedule.begin("one")
    said = "phase 1 of 2: one, then two; all done about 2.0 minutes after that\n"
    assert capsys.readouterr().err == said
    clock.now += 100
    # A quarter took 100 s: 300 s and 120 s.
    schedule.show(0.25)
    assert "all done in about 7.0 minutes" in capsys.readouterr().err
    clock.now += 900
    schedule.begin("two", rest=0.5)
    assert "all done in about 1.0 minutes" in capsys.readouterr().err


def test_a_pretraining_says_what_comes_after_it(
    clock: Clock,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = Schedule({PRETRAIN: 100.0, EXPLORE: 60.0})
    for name, value in run.environment().items():
        monkeypatch.setenv(name, value)
    schedule = module.pretrain_schedule()
    schedule.begin(PRETRAIN)
    assert capsys.readouterr().err == ""
    clock.now += 100
    schedule.show(0.5)
    # 100 s are left, and twice 60.
    assert capsys.readouterr().err == (
        "phase 1 of 2: pre-train, then explore; all done in about 3.7 minutes\n"
    )


def test_a_phase_that_a_run_does_not_have_is_not_announced(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Schedule({"two": 120.0}).begin("one")
    assert capsys.readouterr().err == ""


def test_a_run_with_networks_does_not_pretrain(tmp_path: Path) -> None:
    given = explore_settings("pretrained=somewhere")
    assert list(explore_schedule(given, tmp_path).expected) == [EXPLORE, EVALUATE]
    blind = explore_settings("reward=random")
    assert list(explore_schedule(blind, tmp_path).expected) == [EXPLORE, EVALUATE]
    fresh = explore_settings(f"pretraining.folder={tmp_path}")
    assert next(iter(explore_schedule(fresh, tmp_path).expected)) == PRETRAIN
