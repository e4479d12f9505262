"""Many runs at once in one directory, for `faults`."""

import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fault_files import broken_files, temporary_files
from fault_place import LIMIT_S, Place, shared_memory, wait_until
from fault_runs import EXPLORE, SMALL

#: What is started many times at once: the explorations wait for one pre-training.
EXPLORE_FROM_NOTHING = (
    "explore",
    *SMALL,
    *EXPLORE,
    "maze=maze1",
    "pretraining.scale=smoke",
)
TOUR = ("tour", "scale=smoke")


def run_together(work: Path) -> dict[str, Any]:
    """Six explorations and 24 tours, all at once."""
    return start_together(work / "together", [EXPLORE_FROM_NOTHING] * 6 + [TOUR] * 24)


def start_together(folder: Path, commands: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Start all of them in one directory; how they ended, and what they left."""
    shutil.rmtree(folder, ignore_errors=True)
    place, began = Place(folder), time.monotonic()
    memory = set(shared_memory())
    place.run.mkdir(parents=True)
    started = [
        place.start(words, f"{number}", place.run)
        for number, words in enumerate(commands)
    ]
    within = round(time.monotonic() - began, 2)
    wait_until(lambda: all(one.poll() is not None for one in started), 10 * LIMIT_S)
    hung = sum(one.poll() is None for one in started)
    wait_until(lambda: not place.left(memory), 10)
    left = place.left(memory)
    place.end()
    recipes = sorted({words[0] for words in commands})
    folders = {
        name: len(list((place.run / "runs" / name).iterdir())) for name in recipes
    }
    return {
        "started": len(started),
        "started_within_s": within,
        "ended_well": sum(one.wait() == 0 for one in started),
        "folders": folders,
        "hangs": hung,
        "tracebacks": sum(
            "Traceback" in place.said(f"{n}") for n in range(len(started))
        ),
        "said": sorted(
            {place.said(f"{n}")[-300:] for n, one in enumerate(started) if one.wait()}
        ),
        "broken": broken_files(place.run),
        "stray": temporary_files(place.run),
        "left": left,
        "minutes": round((time.monotonic() - began) / 60, 1),
    }
