import pytest

from toponav.reports import Timer


def test_the_next_time_counts_from_when_what_was_due_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    timer = Timer(10)

    def is_due_at(second: float) -> bool:
        now[0] = second
        return timer.is_due()

    assert [is_due_at(second) for second in (9, 10)] == [False, True]
    # What was due took 15 seconds: ten more until the next time.
    assert [is_due_at(second) for second in (25, 34, 35)] == [False, False, True]
