"""Bad layouts, settings and files by the thousand: what the package says to each.

    python benchmarks/fuzz.py --out results/fuzz.json

Every case is made from its own number, so that one that fails can be run alone
(``--only 17``). A third are layouts, a third command lines of the recipes, a third
damaged maps, networks, checkpoints and run folders. Each runs in a child process with
a limit of time and memory, up to where engines would start, and ends in one of these:

* ``refused``: one sentence, and no run folder is left; of a sweep (``-m``) with several
  jobs, which go on after one that is refused, one sentence each and a last line that
  says so;
* ``accepted``: it is valid, or what is damaged in it does not count;
* ``traceback``: anything else was printed, or a wrong type of error came out;
* ``hang``: it took longer than the limit;
* ``changed``: it was accepted although what was read is not what was written;
* ``litter``: it was refused, and left a run folder.

The last four are faults; they are listed with what was printed.
"""

import argparse
import contextlib
import importlib
import io
import json
import multiprocessing.util
import os
import random
import re
import resource
import shutil
import signal
import string
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf

from toponav import reports, training
from toponav.builders import load_networks, make_layout, make_networks, save_networks
from toponav.config import MazeConfig, ModelConfig, SettingsError
from toponav.envs import DEFAULT_ENGINE, MAZES, load_engine, load_maze
from toponav.graph import MapFileError, load_map, save_map
from toponav.runs import reading_checkpoint, save_atomically

ROOT = Path(__file__).resolve().parent.parent
#: Seconds and bytes of a case.
LIMIT_S, LIMIT_BYTES = 30.0, 12 * 2**30
GOOD, FAULTS = ("refused", "accepted"), ("traceback", "hang", "changed", "litter")
HEADER = {"kind": "toponav exploration", "version": 2}
WORLD = load_engine(DEFAULT_ENGINE).world
MODEL = ModelConfig(
    encoder="small",
    embedding_dim=8,
    batch_norm=True,
    share_encoder=True,
    comparator="difference",
    projection_dim=4,
    comparator_hidden=[4],
    locomotion_hidden=[4],
)


class Accepted(BaseException):
    """A recipe came to where it would start engines."""


@dataclass
class Case:
    """What is tried, in words, and how; ``folder`` must not be left by a refusal."""

    number: int
    kind: str
    what: str
    run: Callable[[], object]
    folder: Path | None = None


# ---------------------------------------------------------------- layouts


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


# ---------------------------------------------------------------- settings

NUMBERS = (
    *("-1", "0", "1", "2", "1000000", "99999999999999999999", "-99999999999999999999"),
    *("1e400", "nan", "inf", "-inf", "0.5", "1e-400", "2147483648", "4294967296"),
    *("9223372036854775807", "1_000", "0x10"),
)
WORDS = (
    *("null", "true", "''", "'a b'", "[1,2]", "[]", "{a:1}", "[a", "{", "???", "*"),
    *(
        "${seed}",
        "${nowhere}",
        "${now:%Y}",
        "${",
        "\\",
        "'",
        '"',
        "a,b",
        "=3",
        "é",
        "\n",
    ),
    *("\x01", "x" * 3000, "../..", "/", "/dev/null", "/proc/x", "~", "auto", "maze9"),
)
#: What Hydra itself must refuse, or take.
WHOLE = (
    *("=3", "=", "+", "~", "~seed", "++", "+foo=1", "++foo=1", "+maze.foo=1", "--zz"),
    *(
        "~maze",
        "~maze.apples",
        "maze",
        "maze=",
        "maze=[]",
        "maze=none",
        "@a=b",
        "a@b=c",
    ),
    *("scale=none", "scale=[a,b]", "hydra.run.dir=/proc/x", "hydra.run.dir=''", "seed"),
    *("hydra.run.dir=/dev/null/x", "hydra.foo=1", "hydra=x", "+hydra.foo=1", "--cfg"),
    *("resume=/nowhere", "resume=/dev/null", "-m", "hydra.job.num=x", "a.b.c.d=1"),
    *("hydra.output_subdir=null", "hydra.verbose=x", "-cn", "-cd=/nowhere", "."),
)


def settings_case(number: int, draw: random.Random, work: Path) -> Case:
    """A command line with one to three settings that are not usual."""
    recipe = draw.choice(
        ["explore", "explore", "pretrain", "tour", "navigate", "report"]
    )
    keys = KEYS[recipe]
    words = []
    for _ in range(draw.choice([1, 1, 2, 3])):
        key, value = draw.choice(keys), draw.choice([*NUMBERS, *WORDS])
        typo = key[:-1] + draw.choice(string.ascii_lowercase)
        key = draw.choice([key] * 8 + [typo, "+" + key, "+" + typo])
        words.append(draw.choice([f"{key}={value}"] * 5 + [draw.choice(WHOLE)]))
    if draw.random() < 0.1:
        words += ["world=gym", "world.id=CartPole-v1"]
    folder = work / f"run-{number}"
    line = ["scale=smoke", *USUAL[recipe], *words]
    if recipe != "report":  # which writes into the folder that it reports on
        line.insert(0, f"hydra.run.dir={folder}")
    what = f"{recipe} {' '.join(words)}"[:200]
    return Case(number, "settings", what, lambda: run_recipe(recipe, line), folder)


def leaves(recipe: str) -> list[str]:
    """Dotted names of a recipe's settings."""
    from hydra import compose, initialize_config_dir

    from toponav.methods import register

    register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose(recipe, overrides=["maze=maze1"] if recipe == "navigate" else [])
    found: list[str] = []

    def walk(entries: Any, prefix: str) -> None:
        for key, value in entries.items():
            if isinstance(value, dict):
                walk(value, f"{prefix}{key}.")
            else:
                found.append(f"{prefix}{key}")

    walk(OmegaConf.to_container(cfg, resolve=False), "")
    return found


def run_recipe(recipe: str, words: list[str]) -> None:
    """The main function of a recipe's script, up to where engines would start."""

    def stop(*_: object, **__: object) -> None:
        raise Accepted

    script = importlib.import_module(f"recipes.{recipe}")
    # What would be played in the meantime; the first of the others ends the recipe.
    reports.start_baselines = lambda *_: None  # type: ignore[assignment]
    ends = ("make_explore_collector", "collect_held_out", "make_env", "make_game_env")
    for name in ends:
        for owner in (script, reports, training):
            if hasattr(owner, name):
                setattr(owner, name, stop)
    sys.argv = [f"{recipe}.py", *words]
    script.main()


# ---------------------------------------------------------------- damaged files


def file_case(number: int, draw: random.Random, work: Path) -> Case:
    """A map, networks, a checkpoint or a run folder that was damaged."""
    makers = [map_case, map_case, networks_case, checkpoint_case, folder_case]
    return draw.choice(makers)(number, draw, work)


def map_state(draw: random.Random) -> dict[str, Any]:
    """A small map with views."""
    generator = torch.Generator().manual_seed(draw.randrange(2**31))
    num, edges = 6, torch.tensor([[0, 1], [1, 2], [2, 3], [0, 5]])
    return {
        "embeddings": torch.randn(num, 8, generator=generator),
        "prepared": torch.randn(num, 4, generator=generator),
        "images": torch.randint(
            0, 256, (num, 6, 5, 3), dtype=torch.uint8, generator=generator
        ),
        "origins": torch.arange(2 * num).reshape(num, 2),
        "edges": edges,
        "traversals": torch.arange(8).reshape(4, 2),
        "edge_similarity": torch.tensor([0.5, float("nan"), 1.0, 0.25]),
        "version": 4,
        "network_version": 1,
        "tc_threshold": 0.9,
        "tc_reach": 0.7,
    }


def map_case(number: int, draw: random.Random, work: Path) -> Case:
    """``map.zip`` with flipped bytes, other arrays, other words, or too much."""
    path, state = work / f"map-{number}.zip", map_state(draw)
    save_map(state, path)
    way = draw.choice(
        ["flip", "cut", "insert", "array", "array", "graph", "graph", "bomb"]
    )
    must_refuse = False
    if way == "array":
        way, must_refuse = replace_array(path, draw), True
    elif way == "graph":
        way, must_refuse = replace_graph(path, draw), True
    elif way == "bomb":
        size = draw.choice([10**8, 10**9])
        name = draw.choice(["embeddings.npy", "graph.json", "views/000000.png", "x"])
        way, must_refuse = f"bomb {name} {size}", True
        rewrite(path, {name: bytes(size)})
    else:
        damage(path, way, draw)

    def run() -> None:
        found, _ = load_map(path)
        same = all(same_value(found[name], state[name]) for name in state)
        require_same(same and not must_refuse)

    return Case(number, "map.zip", way, run)


def replace_array(path: Path, draw: random.Random) -> str:
    """Another array in the place of one of the map's."""
    name = draw.choice(["embeddings", "prepared"])
    arrays: dict[str, Callable[[], np.ndarray]] = {
        "nan": lambda: np.full((6, 8), np.nan, np.float32),
        "infinite": lambda: np.full((6, 8), np.inf, np.float32),
        "complex": lambda: np.ones((6, 8), np.complex64),
        "flat": lambda: np.ones(6, np.float32),
        "deep": lambda: np.ones((6, 2, 2), np.float32),
        "short": lambda: np.ones((5, 8), np.float32),
        "double": lambda: np.ones((6, 8)),
        "words": lambda: np.array([["a"] * 8] * 6),
        "whole": lambda: np.ones((6, 8), np.int64),
        "none": lambda: np.ones((), np.float32),
        "objects": lambda: np.array([[None] * 8] * 6),
    }
    which = draw.choice([*arrays, "liar"])
    buffer = io.BytesIO()
    if which == "liar":  # its header promises far more than there is
        shape = draw.choice([(6, 10**9), (6, 10**18), (10**9, 8), (-6, 8)])
        np.lib.format.write_array_header_1_0(
            buffer, {"descr": "<f4", "fortran_order": False, "shape": shape}
        )
    else:
        np.save(buffer, arrays[which](), allow_pickle=True)
    rewrite(path, {f"{name}.npy": buffer.getvalue()})
    return f"{name} {which}"


def replace_graph(path: Path, draw: random.Random) -> str:
    """One value of ``graph.json`` by another one."""
    with zipfile.ZipFile(path) as archive:
        content = json.loads(archive.read("graph.json"))
    bad: Any = draw.choice([-1, 10**30, 1.5, "x", [], {}, True, float("nan"), 10**9])
    where = draw.choice(["nodes", "edges", "graph", "deep", "whole"])
    if where == "deep":
        data = b"[" * 100_000 + b"]" * 100_000
    else:
        key = where
        if where == "whole":
            key = draw.choice(["nodes", "edges", "graph", "format", "format_version"])
            content[key] = bad
        elif where == "graph":
            key = draw.choice(
                ["version", "network_version", "tc_threshold", "tc_reach"]
            )
            bad = -1 if bad is True or (isinstance(bad, int) and bad > 1) else bad
            content["graph"][key] = -0.5 if bad == 1.5 else bad
        else:
            row = draw.choice(content[where])
            key = draw.choice(sorted(set(row) - {"id"}))
            # Any origin is a count, and no similarity is none of these.
            row[key] = -1 if bad in (10**9, True) else bad
        where = f"{where} {key}={bad!r}"
        data = json.dumps(content).encode()
    rewrite(path, {"graph.json": data})
    return where


def networks_case(number: int, draw: random.Random, work: Path) -> Case:
    """``networks.pt`` with flipped bytes, text, or weights that are no numbers."""
    path = work / f"networks-{number}.pt"
    torch.manual_seed(number)
    networks = make_networks(MODEL, WORLD)
    way = draw.choice(["flip", "flip", "cut", "insert", "text", "nan", "entries"])
    wanted = {name: one.clone() for name, one in networks.modules.state_dict().items()}
    if way == "nan":
        values = draw.choice(list(networks.modules.parameters())).data
        place = tuple(draw.randrange(length) for length in values.shape)
        values[place] = draw.choice([np.nan, np.inf])
    save_networks(networks, path)
    if way == "entries":
        state = torch.load(path, weights_only=True)
        key = draw.choice(sorted(state))
        bad = draw.choice([None, -1, "x", [1], {}, torch.zeros(3), 10**30])
        state[key] = bad
        way = f"entries {key}={bad}"
        save_atomically(state, path)
    elif way != "nan":
        damage(path, way, draw)

    def run() -> None:
        found = load_networks(path).modules.state_dict()
        require_same(all(same_value(found[name], wanted[name]) for name in wanted))

    return Case(number, "networks.pt", way, run)


def checkpoint_case(number: int, draw: random.Random, work: Path) -> Case:
    """``checkpoint.pt`` with flipped bytes, text, or weights that are no numbers."""
    path = work / f"checkpoint-{number}.pt"
    policy = {"w": torch.arange(3000.0), "b": torch.zeros(3)}
    way = draw.choice(["flip", "flip", "cut", "insert", "text", "nan", "kind"])
    state = {**HEADER, "consumers": {"learner": {"policy": policy}}}
    if way == "nan":
        policy["b"][1] = torch.nan
    if way == "kind":
        state["version"] = draw.choice([1, 3, None, "2", torch.zeros(2)])
    save_atomically(state, path)
    if way not in ("nan", "kind"):
        damage(path, way, draw)

    def run() -> None:
        with reading_checkpoint(path, "resume", HEADER, "an exploration") as found:
            values = found["consumers"]["learner"]["policy"]
        require_same(all(same_value(values[name], policy[name]) for name in policy))

    return Case(number, "checkpoint.pt", way, run)


def folder_case(number: int, draw: random.Random, work: Path) -> Case:
    """A run folder to resume whose settings were damaged."""
    folder = work / f"resumed-{number}"
    (folder / "config").mkdir(parents=True)
    texts = {"config": "seed: 0\nmaze:\n  name: maze1\n", "overrides": "- seed=3\n"}
    for name, text in texts.items():
        (folder / f"config/{name}.yaml").write_text(text)
    file = folder / "config" / f"{draw.choice(list(texts))}.yaml"
    way = draw.choice(["flip", "cut", "insert", "text", "words", "gone"])
    if way == "words":
        words = [
            "[",
            "- {",
            "a: b: c",
            "3",
            "- =3",
            "- 7",
            "- null",
            "!!python/x 1",
            "&a",
        ]
        way = draw.choice([*words, "- - a", "seed: *a", "\t", "- seed=-1", "{1: 2}"])
        file.write_text(way)
    elif way == "gone":
        file.unlink()
    else:
        damage(file, way, draw)
    recipe = draw.choice(["explore", "pretrain"])
    words = ["scale=smoke", *USUAL[recipe], f"resume={folder}"]
    return Case(
        number,
        "run folder",
        f"{recipe} {file.stem} {way}",
        lambda: run_recipe(recipe, words),
    )


def damage(path: Path, way: str, draw: random.Random) -> None:
    """Flip, cut off or insert bytes of a file, or replace it by text."""
    data = path.read_bytes()
    if way == "flip":
        data = flipped(data, draw, draw.choice([1, 1, 2, 20]))
    elif way == "cut":
        data = data[: draw.randrange(len(data))]
    elif way == "insert":
        at = draw.randrange(len(data))
        data = data[:at] + draw.randbytes(draw.randint(1, 100)) + data[at:]
    else:
        data = draw.choice([b"", b"hello\n", b"\x80\x02.", b"PK\x03\x04", b"{}" * 50])
    path.write_bytes(data)


def flipped(data: bytes, draw: random.Random, times: int) -> bytes:
    """The same with some bits changed."""
    found = bytearray(data)
    for _ in range(times):
        found[draw.randrange(len(found))] ^= 1 << draw.randrange(8)
    return bytes(found)


def rewrite(path: Path, entries: dict[str, bytes]) -> None:
    """The same archive with other entries."""
    with zipfile.ZipFile(path) as archive:
        kept = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in (kept | entries).items():
            archive.writestr(name, data)


def same_value(one: Any, other: Any) -> bool:
    """Whether two entries of a map are equal; NaN equals NaN."""
    if isinstance(one, torch.Tensor):
        return torch.equal(torch.nan_to_num(one), torch.nan_to_num(other))
    return bool(one == other)


def require_same(same: bool) -> None:
    """End the child process as ``changed`` if what was read is another thing."""
    if not same:
        os._exit(_CHANGED)


# ---------------------------------------------------------------- running

_CHANGED, _ACCEPTED, _RAISED = 70, 71, 72
MAKERS = (layout_case, settings_case, file_case)
KEYS: dict[str, list[str]] = {}
USUAL: dict[str, list[str]] = {
    "explore": ["reward=random"],
    "pretrain": ["model.embedding_dim=8"],
    "tour": [],
    "navigate": ["maze=maze1"],
    "report": ["folder=/nowhere"],
}


def make_case(number: int, work: Path) -> Case:
    """The case of a number: always the same one."""
    draw = random.Random(number)
    return MAKERS[number % len(MAKERS)](number, draw, work)


def outcome(case: Case, work: Path) -> tuple[str, str]:
    """Run a case in a child process; how it ended, and what it printed."""
    said = work / "said.txt"
    child = os.fork()
    if child == 0:
        run_child(case, said, work)
    deadline, status = time.monotonic() + LIMIT_S, None
    while status is None and time.monotonic() < deadline:
        found, code = os.waitpid(child, os.WNOHANG)
        status = code if found else None
        time.sleep(0.002)
    if status is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return "hang", said.read_text(errors="replace")[-500:]
    text, code = (
        said.read_text(errors="replace").strip(),
        os.waitstatus_to_exitcode(status),
    )
    if code == _CHANGED:
        return "changed", text
    if code in (0, _ACCEPTED):
        return "accepted", text
    if not is_refusal(text) or code not in (1, 2, _RAISED):
        return "traceback", f"[{code}] {text[-1500:]}"
    if case.folder is not None and case.folder.exists():
        return "litter", text
    return "refused", text


def is_refusal(text: str) -> bool:
    r"""Whether one sentence was printed, or those of a sweep with several jobs.

    Examples:
        >>> is_refusal("tour: seed must be 0"), is_refusal("one\ntwo")
        (True, False)
    """
    lines = text.splitlines()
    if len(lines) > 2 and lines[-1].endswith(": not all jobs of the sweep succeeded"):
        # Each ends with the job's settings.
        return all(re.match(r"\w+: .*\(.*\)$", line) for line in lines[:-1])
    return len(lines) == 1 and "Traceback" not in text


def run_child(case: Case, said: Path, work: Path) -> None:
    """Run a case with limits, and end the process by what came of it."""
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    os.chdir(work)
    errors = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(errors, 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.stderr = os.fdopen(2, "w", buffering=1)
    code = _ACCEPTED
    try:
        case.run()
    except (Accepted, KeyboardInterrupt):
        pass
    except SystemExit as end:
        code = int(end.code or 0)
    except (SettingsError, MapFileError) as error:
        print(error, file=sys.stderr)
        code = _RAISED
    except BaseException:
        import traceback

        traceback.print_exc()
        code = 99
    sys.stderr.flush()
    # A recipe's own process ends with this: named semaphores are removed.
    multiprocessing.util._exit_function()
    os._exit(code)


def run_cases(numbers: Iterator[int] | range | list[int]) -> dict[str, Any]:
    """Counts of outcomes by kind, and the faults with what was said."""
    counts: dict[str, Counter[str]] = {}
    faults, slowest = [], 0.0
    with tempfile.TemporaryDirectory(prefix="toponav-fuzz-") as folder:
        work = Path(folder)
        for number in numbers:
            case = make_case(number, work)
            started = time.monotonic()
            how, text = outcome(case, work)
            slowest = max(slowest, time.monotonic() - started)
            counts.setdefault(case.kind, Counter())[how] += 1
            if how in FAULTS:
                faults.append(
                    {"case": number, "how": how, "what": case.what, "said": text}
                )
                print(f"{number} {how}: {case.what}\n    {text[-300:]}", flush=True)
            for path in work.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    total = Counter[str]()
    for one in counts.values():
        total.update(one)
    return {
        "total": {how: total[how] for how in (*GOOD, *FAULTS)},
        "by_kind": {kind: dict(sorted(one.items())) for kind, one in counts.items()},
        "slowest_s": round(slowest, 2),
        "faults": faults,
    }


def prepare() -> None:
    """Load all that a case needs, so that child processes have it."""
    torch.set_num_threads(1)
    for recipe in USUAL:
        importlib.import_module(f"recipes.{recipe}")
        KEYS[recipe] = leaves(recipe)


def main() -> None:
    """Run the cases and write the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    prepare()
    started = time.monotonic()
    found = run_cases(arguments.only or range(arguments.cases))
    found["minutes"] = round((time.monotonic() - started) / 60, 1)
    print(
        json.dumps({name: found[name] for name in found if name != "faults"}, indent=1)
    )
    if arguments.out:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
