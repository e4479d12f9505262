import errno
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from toponav.runs import replacing, write_text


def test_a_file_is_replaced_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".txt")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def run_out_of_space() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        run_out_of_space()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_fails_while_it_is_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    reason = "No space left on device"
    with pytest.raises(OSError, match=f"{reason}: '{path}'"), replacing(path):
        raise OSError(errno.ENOSPC, reason)
    reason = "Read-only file system"
    with (
        pytest.raises(OSError, match=f"{reason}: '{path}'"),
        replacing(path) as temporary,
    ):
        raise OSError(errno.EROFS, reason, temporary)


def test_a_reader_never_finds_half_a_file(tmp_path: Path) -> None:
    path, stop = tmp_path / "a.txt", threading.Event()
    contents = {letter * 300_000 for letter in "ab"}
    write_text(path, "a" * 300_000)
    found = []

    def read() -> None:
        while not stop.is_set():
            found.append(path.read_text() in contents)

    reader = threading.Thread(target=read)
    reader.start()
    for _ in range(10):
        for content in contents:
            write_text(path, content)
    stop.set()
    reader.join()
    assert found
    assert all(found)


# In a process of its own: where the error reaches PyTorch's writer, it may abort.
INTERRUPTED = """
import signal, sys, time
from pathlib import Path
import torch
from toponav.runs import save_atomically

path = Path(sys.argv[1])
state = {str(number): torch.zeros(5000) for number in range(1000)}
took = []
for _ in range(3):
    began = time.monotonic()
    save_atomically(state, path)
    took.append(time.monotonic() - began)
signal.signal(signal.SIGALRM, lambda number, _: sys.exit(128 + number))
for step in range(40):  # from the first tensors to the last
    try:
        signal.setitimer(signal.ITIMER_REAL, max(min(took) * step / 40, 1e-3))
        save_atomically(state, path)
        time.sleep(max(took))
    except SystemExit:
        print("stopped")
    assert len(torch.load(path)) == 1000
"""


def test_a_signal_in_the_middle_of_a_save_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    command = [sys.executable, "-c", INTERRUPTED, str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.stdout.split(), ended.returncode) == (["stopped"] * 40, 0), ended
    assert list(tmp_path.iterdir()) == [path]
