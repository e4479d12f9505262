"""Lock files: one holder at a time, and none left behind."""

import fcntl
import shutil
import threading
from pathlib import Path

import pytest

from toponav.config import SettingsError
from toponav.runs import alone_in, locked

WAIT_S = 20


def test_a_lock_is_gone_after_the_block(tmp_path: Path) -> None:
    path = tmp_path / "new" / ".lock"
    with locked(path):
        assert path.exists()
        with pytest.raises(BlockingIOError), locked(path, wait=False):
            pass
    assert not path.exists()
    with pytest.raises(ValueError, match="inside"), locked(path):
        raise ValueError("inside")
    assert not path.exists()
    # What a killed process leaves is no obstacle.
    path.touch()
    with locked(path, wait=False):
        pass
    assert not path.exists()


def test_who_waited_for_a_lock_that_was_removed_waits_for_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first leaves, a third comes, then the second gets the first one's file."""
    path, flock, order = tmp_path / ".lock", fcntl.flock, list[str]()
    second_waits, third_holds = threading.Event(), threading.Event()

    def slow_flock(file: object, how: int) -> None:
        # Of the second, the first attempt alone: what it gets comes late.
        late = threading.current_thread() is second and not second_waits.is_set()
        if late:
            second_waits.set()
        flock(file, how)  # type: ignore[arg-type]
        if late:
            assert third_holds.wait(WAIT_S)

    def hold() -> None:
        with locked(path):
            order.append("second")

    second = threading.Thread(target=hold)
    monkeypatch.setattr(fcntl, "flock", slow_flock)
    with locked(path):
        second.start()
        assert second_waits.wait(WAIT_S)
    with locked(path):
        third_holds.set()
        second.join(0.2)
        order.append("third")
    second.join(WAIT_S)
    assert order == ["third", "second"]
    assert not path.exists()


def test_a_lock_that_has_another_ones_name_by_now_is_left_alone(tmp_path: Path) -> None:
    """A refused run removes its folder, and another run makes it again."""
    path = tmp_path / "config" / ".lock"
    with locked(path):
        shutil.rmtree(path.parent)
        other = locked(path, wait=False)
        other.__enter__()
    assert path.exists()
    other.__exit__(None, None, None)
    assert not path.exists()


def test_many_at_once_take_turns(tmp_path: Path) -> None:
    path, inside, most = tmp_path / ".lock", [0], [0]

    def take_turns() -> None:
        for _ in range(100):
            with locked(path):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                inside[0] -= 1
            counts.append(1)

    counts: list[int] = []
    threads = [threading.Thread(target=take_turns) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(WAIT_S)
    assert (len(counts), most[0]) == (400, 1)
    assert not path.exists()


def test_a_folder_that_another_run_writes_to_is_refused(tmp_path: Path) -> None:
    with alone_in(tmp_path / "config"):
        with pytest.raises(SettingsError, match="another run is writing to: '"):
            alone_in(tmp_path / "config").__enter__()
        with pytest.raises(ValueError, match="inside"), alone_in(tmp_path / "other"):
            # Of the block itself, which may meet a lock of another kind.
            raise ValueError("inside")
    assert not list(tmp_path.rglob(".lock"))
