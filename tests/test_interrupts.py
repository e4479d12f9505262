"""Ctrl-C and SIGTERM in a recipe's process, from its first import to its end."""

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from toponav.config import SettingsError
from toponav.interrupts import catch_as_usual, catch_early

REPOSITORY = Path(__file__).parent.parent
RECIPES = sorted((REPOSITORY / "recipes").glob("*.py"))
#: Stands for torch, which every recipe imports, and gets the signal meanwhile.
TORCH = """
import os, signal, time
os.kill(os.getpid(), signal.{})
print("went on", flush=True)
os._exit(0)
"""
#: Gets the signal when Python frees its modules and has no handlers any more.
LATE = """
import os, signal
from toponav.interrupts import ignore_signals

class Last:
    def __del__(self, kill=os.kill, me=os.getpid()):
        kill(me, signal.{})

last = Last()
ignore_signals()
"""
#: Gets the signal while Matplotlib holds the lock on its list of fonts.
FONTS = """
import os, signal, sys
from contextlib import contextmanager
import matplotlib.cbook
lock_path = matplotlib.cbook._lock_path

@contextmanager
def interrupted(path):
    with lock_path(path):
        os.kill(os.getpid(), signal.{})
        yield

matplotlib.cbook._lock_path = interrupted
sys.argv[0] = "explore.py"
from toponav.interrupts import catch_early
catch_early("__main__")
print("went on")
"""
NUMBERS = (signal.SIGINT, signal.SIGTERM)
RUN = "import runpy, sys; runpy.run_path(sys.argv[1], run_name='{}')"


@pytest.fixture
def own_signals(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a recipe's process answers, for one test."""
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    before = {number: signal.getsignal(number) for number in NUMBERS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def interrupt(
    recipe: Path, folder: Path, *, name: str, number: signal.Signals, ignored: bool
) -> subprocess.CompletedProcess[str]:
    """A recipe that is run under this ``__name__``, up to its import of torch."""
    (folder / "torch.py").write_text(TORCH.format(number.name))
    code = f"import sys; sys.argv[0] = sys.argv[1]; {RUN.format(name)}"
    handler = signal.SIG_IGN if ignored else signal.SIG_DFL
    return subprocess.run(
        [sys.executable, "-c", code, str(recipe)],
        env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{REPOSITORY}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        # Those that a shell has put into the background ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, handler),
    )


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
def test_ctrl_c_while_a_recipe_imports_is_one_sentence(
    recipe: Path, tmp_path: Path
) -> None:
    done = interrupt(
        recipe, tmp_path, name="__main__", number=signal.SIGINT, ignored=False
    )
    assert done.stderr == f"{recipe.stem}: stopped by Ctrl-C\n"
    assert done.returncode == 128 + signal.SIGINT
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("name", "number", "ignored", "status"),
    [
        ("__main__", signal.SIGTERM, False, 128 + signal.SIGTERM),
        ("__main__", signal.SIGINT, True, 0),
        ("__mp_main__", signal.SIGINT, False, 0),
    ],
    ids=["SIGTERM", "Ctrl-C in the background", "Ctrl-C for a collecting process"],
)
def test_other_signals_are_silent(
    tmp_path: Path, name: str, number: signal.Signals, ignored: bool, status: int
) -> None:
    recipe = REPOSITORY / "recipes/explore.py"
    done = interrupt(recipe, tmp_path, name=name, number=number, ignored=ignored)
    assert (done.returncode, done.stderr) == (status, "")
    assert done.stdout == ("" if status else "went on\n")


@pytest.mark.usefixtures("own_signals")
@pytest.mark.parametrize("alive", [True, False])
def test_a_process_whose_run_was_killed_ends_without_a_word(
    alive: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = SimpleNamespace(is_alive=lambda: alive)
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: run)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    catch_early("__mp_main__")
    error = ConnectionResetError("by peer")
    sys.excepthook(type(error), error, None)
    assert ("by peer" in capsys.readouterr().err) == alive


def test_who_imports_a_recipe_keeps_its_signals() -> None:
    before = [signal.getsignal(one) for one in NUMBERS]
    importlib.reload(importlib.import_module("recipes.tour"))
    assert before == [signal.getsignal(one) for one in NUMBERS]


@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_after_the_last_line_changes_nothing(number: signal.Signals) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LATE.format(number.name)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("own_signals")
@pytest.mark.parametrize("fails", [False, True])
def test_a_recipe_ignores_signals_once_its_last_job_is_done(
    fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def jobs() -> None:
        # Between the jobs of a sweep they are answered.
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_IGN
        if fails:
            raise SettingsError("a setting must be right, got a wrong one")

    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr("sys.argv", ["tour.py"])
    monkeypatch.setattr("hydra.main", lambda **_: lambda _: jobs)
    main = importlib.import_module("recipes.tour").main
    with pytest.raises(SystemExit) if fails else nullcontext():
        main()
    ignored = [signal.getsignal(number) is signal.SIG_IGN for number in NUMBERS]
    # What failed may take long to clean up: a second Ctrl-C insists.
    assert ignored == 2 * [not fails]


@pytest.mark.usefixtures("own_signals")
def test_ctrl_c_raises_again_once_everything_is_imported() -> None:
    catch_early("__main__")
    assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    catch_as_usual()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    with pytest.raises(SystemExit, match="143"):
        signal.raise_signal(signal.SIGTERM)


class Freed:
    """What may be referred to weakly."""


def get_where_exceptions_are_lost(number: int) -> None:
    """Get a signal in the callback of a weak reference, then work for seconds."""
    thing = Freed()
    reference = weakref.ref(thing, lambda _: os.kill(os.getpid(), number))
    del thing
    assert reference() is None
    for _ in range(400):
        time.sleep(0.01)


@pytest.mark.usefixtures("own_signals")
@pytest.mark.parametrize(
    ("number", "error"),
    [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)],
)
def test_a_signal_is_answered_where_python_loses_exceptions(
    number: int, error: type[BaseException], capsys: pytest.CaptureFixture[str]
) -> None:
    catch_as_usual()
    with pytest.raises(error):
        get_where_exceptions_are_lost(number)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("own_signals")
def test_other_exceptions_that_python_loses_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    catch_as_usual()
    thing = Freed()
    reference = weakref.ref(thing, lambda _: [][0])
    del thing
    assert reference() is None
    said = capsys.readouterr().err
    assert said.startswith("Exception ignored in")
    assert "IndexError" in said


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: number.name)
def test_a_signal_while_fonts_are_listed_leaves_no_lock(
    number: signal.Signals, tmp_path: Path
) -> None:
    fresh = tmp_path / "fontlist-v1.json.matplotlib-lock"  # of another process
    stale = tmp_path / "fontlist-v2.json.matplotlib-lock"
    for lock in (fresh, stale):
        lock.touch()
    os.utime(stale, (0, 0))
    done = subprocess.run(
        [sys.executable, "-c", FONTS.format(number.name)],
        env={**os.environ, "MPLCONFIGDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert done.stderr == (
        "explore: stopped by Ctrl-C\n" if number == signal.SIGINT else ""
    )
    assert list(tmp_path.glob("*lock")) == [fresh]
    assert [path.suffix for path in tmp_path.glob("fontlist-v[3-9]*")] == [".json"]
