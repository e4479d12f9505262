"""Recipes in a fork of this process, which has loaded already what they import.

For what ends in a sentence before anything starts, and for recipes that start no
process of Python's: loading torch again takes longer than all that they do.
"""

import importlib
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from tqdm import tqdm

ROOT = Path(__file__).parent.parent


def run_forked(
    recipe: str,
    *words: str,
    cwd: Path = ROOT,
    timeout: float = 240,
    inside: AbstractContextManager[object] = nullcontext(),  # noqa: B008
) -> subprocess.CompletedProcess[str]:
    """Run a recipe's main function with a command line; its status and what it printed.

    Args:
        recipe: its name, as in ``recipes/``.
        words: the command line.
        cwd: the working directory.
        timeout: seconds.
        inside: what is entered around it.
    """
    # What the recipe imports is loaded once, by the first that needs it.
    script = importlib.import_module(f"recipes.{recipe}")
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, name) for name in ("stdout", "stderr")]
        context = multiprocessing.get_context("fork")
        child = context.Process(
            target=_run,
            args=(script.main, [f"{recipe}.py", *words], cwd, paths, inside),
        )
        child.start()
        child.join(timeout)
        if child.is_alive():
            child.kill()
            child.join()
            raise subprocess.TimeoutExpired([recipe, *words], timeout)
        output, errors = (path.read_text(encoding="utf-8") for path in paths)
    status = child.exitcode
    assert status is not None
    return subprocess.CompletedProcess([recipe, *words], status, output, errors)


def own_progress() -> None:
    """In a child: its progress bars share no lock with the parent.

    A thread of the parent may hold it at the fork, and a child that is killed may: then
    both would hang.
    """
    tqdm.set_lock(threading.RLock())


def _run(main, words: list[str], cwd: Path, paths: list[Path], inside) -> None:
    """In the child: with standard streams, working directory and command line."""
    own_progress()
    for number, path in enumerate(paths, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    sys.stdout, sys.stderr = (os.fdopen(one, "w", buffering=1) for one in (1, 2))
    os.chdir(cwd)
    sys.argv = words
    with inside:
        main()
