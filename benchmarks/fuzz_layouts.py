"""Layouts for `fuzz`: a maze's text, changed in some way, or something else."""

import contextlib
import os
import random
import string
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzz_cases import ROOT, Case
from fuzz_damage import flipped
from omegaconf import OmegaConf

from toponav.builders import make_layout
from toponav.config import MazeConfig
from toponav.envs import MAZES, load_maze


def layout_case(number: int, draw: random.Random, work: Path) -> Case:
    """A maze's text, changed in some way, or something that is no text."""
    path = work / f"layout-{number}.txt"
    text = load_maze(draw.choice(MAZES)).text
    ways: dict[str, Callable[[], bytes]] = {
        "letters": lambda: changed_letters(text, draw).encode(),
        "bytes": lambda: flipped(text.encode(), draw, draw.randint(1, 8)),
        "cut": lambda: text.encode()[: draw.randrange(len(text))],
        "lines": lambda: shuffled_lines(text, draw).encode(),
        "noise": lambda: draw.randbytes(draw.choice([0, 1, 10, 1000, 200_000])),
        "large": lambda: box(draw.randint(1, 400), draw.randint(1, 400)),
        "code": lambda: text.encode(draw.choice(["utf-16", "utf-32", "utf-8-sig"])),
        "ends": lambda: text.replace(
            "\n", draw.choice(["\r", "\r\n", "\n\n"])
        ).encode(),
        "sparse": lambda: b"",
        "pipe": lambda: b"",
        "device": lambda: b"",
        "name": lambda: b"",
    }
    way = draw.choice(list(ways))
    given = str(path)
    if way == "pipe":
        os.mkfifo(path)
    elif way == "device":
        given = draw.choice(
            ["/dev/zero", "/dev/tty", "/dev/random", "/", "/proc/kcore"]
        )
    elif way == "name":
        given = draw.choice(["", "x" * 5000, "a\0b", "a\nb", "/nowhere/x", "~", "."])
    else:
        path.write_bytes(ways[way]())
        if way == "sparse":
            os.truncate(path, draw.choice([10**6, 10**10, 10**13]))

    def run() -> None:
        with contextlib.ExitStack() as stack:
            stack.callback(lambda: path.unlink(missing_ok=True))
            maze = maze_config(given)
            make_layout(maze)

    return Case(number, "layout", f"{way} {given[:60]!r}", run)


def maze_config(path: str) -> MazeConfig:
    """``maze=file`` with a layout of this name."""
    values = OmegaConf.load(ROOT / "conf" / "maze" / "base.yaml")
    entries: dict[str, Any] = dict(OmegaConf.to_container(values))  # type: ignore[arg-type]
    entries.pop("defaults", None)
    return MazeConfig(**{**entries, "name": "file", "path": path})


def changed_letters(text: str, draw: random.Random) -> str:
    """Some letters replaced by others."""
    letters = list(text)
    for _ in range(draw.randint(1, 6)):
        at = draw.randrange(len(letters))
        letters[at] = draw.choice("* abzZ\t#\n\u00e9\u2028\x00" + string.printable)
    return "".join(letters)


def shuffled_lines(text: str, draw: random.Random) -> str:
    """Lines removed, doubled or exchanged."""
    lines = text.split("\n")
    at, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    lines[at] = draw.choice(["", lines[other], lines[at] * 2, lines[at][:-1]])
    return "\n".join(lines)


def box(rows: int, columns: int) -> bytes:
    """An empty hall, valid if it is not too small or too large."""
    inner = "*" + " " * max(columns - 2, 0) + "*"
    middle = [inner] * max(rows - 2, 0)
    return "\n".join(["*" * len(inner), *middle, "*" * len(inner)]).encode()
