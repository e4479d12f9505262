"""Runs that are killed at random moments: do they end, and does a resume go on?

    python benchmarks/faults.py --out results/faults.json
    python benchmarks/faults.py --kills 7
    python benchmarks/faults.py --kills 0 --together --out results/faults.json

Each case is made from its own number, so that one that fails can be run again
(``--only 17``). It runs a recipe at ``scale=smoke`` in a session of its own, waits for
a random moment of its life, counted in seconds of a core, so that a busy machine
changes nothing, kills a target, waits for the end of all processes, looks at every
file, and resumes. Where the run is too young for that, which is one sentence, it is
started again. Its faults:

* ``hang``: a process of Python's lived on for longer than the limit;
* ``traceback``: one was printed, or the run failed without a sentence;
* ``broken``: a file of the run folder cannot be read;
* ``stray``: a temporary file is left after the resume;
* ``left``: a process, an engine's folder or shared memory is left after the resume;
* ``resume``: it did not end well, or was refused although there was a checkpoint.

``--together`` starts six explorations, which share one pre-training, and 24 tours at
once in one directory. Finished cases are kept in ``--work``, line by line in
``cases.jsonl``: the same command goes on where it was cut off.
"""

import argparse
import csv
import json
import math
import os
import platform
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import psutil
import torch
import yaml
from PIL import Image
from tqdm import tqdm

from toponav.graph import load_map

ROOT = Path(__file__).resolve().parent.parent
#: Seconds that a run, or what is left of one that was killed, may take: many, since a
#: busy machine is slow, and a hang has no end.
LIMIT_S, END_S = 900.0, 300.0
SMALL = ("scale=smoke", "model.embedding_dim=8", "maze.episode_length=32")
EXPLORE = (
    *("collect.decisions=512", "collect.max_idle_s=200", "policy.hidden=16"),
    *("evaluate.episodes=1", "evaluate.random_episodes=1", "report.every=128"),
    *("report.pictures_every_s=1", "report.save_every_s=0.5"),
)
RUNS: dict[str, tuple[str, ...]] = {
    "explore sync": ("explore", *SMALL, *EXPLORE),
    "explore async": (
        *("explore", *SMALL, *EXPLORE, "collect.mode=async", "collect.workers=2"),
    ),
    "pretrain": (
        *("pretrain", *SMALL, "collect.max_idle_s=200", "train.save_every_s=0.01"),
        *("validate.decisions=60", "validate.every=5"),
    ),
    # It ends as the default does: the map is made again by poses, while processes of
    # their own play the evaluation, which has to be long enough for them.
    "explore poses": (
        *("explore", *SMALL, *EXPLORE, "map.poses=true"),
        *("maze.episode_length=128", "evaluate.episodes=160"),
    ),
}
#: What is started many times at once: the explorations wait for one pre-training.
EXPLORE_FROM_NOTHING = (
    "explore",
    *SMALL,
    *EXPLORE,
    "maze=maze1",
    "pretraining.scale=smoke",
)
TOUR = ("tour", "scale=smoke")
TARGETS = (
    *("main SIGKILL", "group SIGKILL", "worker SIGKILL", "engine SIGKILL"),
    *("main SIGTERM", "main SIGINT", "group SIGINT"),
)
#: What the command line of an engine has in it.
ENGINE = "engine.ini"
FAULTS = ("hang", "traceback", "broken", "stray", "left", "resume")


@dataclass
class Place:
    """Where the runs of a case are, and the mark by which its processes are known.

    ``marks`` are their numbers and those of engines, which names in shared memory have.
    """

    folder: Path
    marks: set[str] = field(default_factory=set)

    @property
    def temporary(self) -> Path:
        return self.folder / "tmp"

    @property
    def run(self) -> Path:
        return self.folder / "run"

    def start(self, words: Sequence[str], name: str, cwd: Path) -> subprocess.Popen:
        """A recipe in a session of its own; what it prints goes into files."""
        self.temporary.mkdir(parents=True, exist_ok=True)
        recipe, *settings = words
        inherited = {"PYTHONPATH": str(ROOT), "TMPDIR": str(self.temporary)}
        cache = {"XDG_CACHE_HOME": str(self.folder / "cache")}
        with (
            (self.folder / f"{name}.out").open("wb") as output,
            (self.folder / f"{name}.err").open("wb") as errors,
        ):
            return subprocess.Popen(
                [sys.executable, str(ROOT / "recipes" / f"{recipe}.py"), *settings],
                cwd=cwd,
                env={**os.environ, **inherited, **cache},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                start_new_session=True,
                # A shell that starts this in the background ignores Ctrl-C.
                preexec_fn=_take_signals,
            )

    def said(self, name: str) -> str:
        return (self.folder / f"{name}.err").read_text(errors="replace")

    def processes(self, word: str = "", but: str = "\0") -> list[psutil.Process]:
        """Those with this place's folder for temporary files, whoever started them.

        Their command lines have one word in them, and not the other.
        """
        found = []
        for process in psutil.process_iter():
            try:
                mine = process.environ().get("TMPDIR") == str(self.temporary)
                line = " ".join(process.cmdline()) if mine else ""
                if mine:
                    engine = re.findall(r"\+viz_instance_id (\w+)", line)
                    self.marks.update([str(process.pid), *engine])
                if mine and word in line and but not in line:
                    found.append(process)
            except psutil.Error:  # it has ended, or is somebody else's
                continue
        return [one for one in found if one.pid != os.getpid()]

    def wait(self, process: subprocess.Popen, core_s: float = math.inf) -> float:
        """Wait until a run has used so much, or ends; what its processes used."""
        used, deadline = dict[int, float](), time.monotonic() + LIMIT_S
        while process.poll() is None and sum(used.values()) < core_s:
            for one in self.processes():
                with suppress(psutil.Error):
                    used[one.pid] = sum(one.cpu_times()[:2])
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(process.args, LIMIT_S)
            time.sleep(0.05)
        return sum(used.values())

    def left(self, memory: set[str]) -> list[str]:
        """Processes, folders of engines, and shared memory that is new."""
        found = [" ".join(one.cmdline())[:200] for one in self.processes()]
        found += [str(one) for one in self.temporary.glob("toponav-*/vizdoom-*/*")]
        if new := set(_shared_memory()) - memory:
            found += sorted(filter(self._may_own, new - _mapped()))
        return found

    def _may_own(self, name: str) -> bool:
        """Whether a name in shared memory may be of this place: others run, too."""
        owner = re.match(r"(?:ViZDoom(?:SM|MQCtr|MQDoom)|sem.loky-|torch_)(\w+)", name)
        return owner is None or owner[1].partition("_")[0] in self.marks

    def end(self) -> None:
        for process in self.processes():
            process.kill()


def _take_signals() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_until(over: Callable[[], bool], seconds: float) -> bool:
    """Whether it was over within so many seconds."""
    deadline = time.monotonic() + seconds
    while not (found := over()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


# ---------------------------------------------------------------- one case


def prepare(work: Path) -> tuple[Path, dict[str, float]]:
    """Networks for all explorations, and what each run uses undisturbed."""
    place, file = Place(work / "whole"), work / "seconds.json"
    networks = place.folder / "pretrain" / "networks.pt"
    seconds = json.loads(file.read_text()) if file.exists() else {}
    # The first makes the networks of the others.
    for name in sorted(RUNS, key=lambda name: name != "pretrain"):
        if name in seconds:
            continue
        folder = place.folder / name.replace(" ", "-")
        shutil.rmtree(folder, ignore_errors=True)
        process = place.start(command(name, networks, folder), name, ROOT)
        seconds[name] = round(place.wait(process), 1)
        if process.wait() != 0:
            raise SystemExit(f"{name} must work undisturbed: {place.said(name)}")
    file.write_text(json.dumps(seconds))
    return networks, seconds


def command(name: str, networks: Path, folder: Path) -> list[str]:
    """The command line of one of the `RUNS`."""
    given = [f"pretrained={networks}"] if name.startswith("explore") else []
    return [*RUNS[name], *given, f"hydra.run.dir={folder}"]


def run_case(
    number: int, work: Path, networks: Path, seconds: dict[str, float]
) -> dict[str, Any]:
    """Kill a run at a random moment; what was found, or that it had ended before."""
    draw = random.Random(number)
    name = tuple(RUNS)[number % len(RUNS)]
    target = TARGETS[number % len(TARGETS)]
    moment = draw.uniform(0, 0.98 * seconds[name])
    place = Place(work / f"case-{number}")
    shutil.rmtree(place.folder, ignore_errors=True)
    memory = set(_shared_memory())
    process = place.start(command(name, networks, place.run), "first", ROOT)
    place.wait(process, moment)
    victims = wait_for_victims(place, process, target)
    found: dict[str, Any] = {
        "case": number,
        "run": name,
        "target": target,
        "core_s": round(moment, 1),
        "killed": bool(victims),
        "faults": {},
    }
    faults = found["faults"]
    try:
        strike(victims, process, target)
        faults |= judge(place, process, name, target)
        again = command(name, networks, place.run)
        found["resume"] = resume(place, name, again, faults)
        # Those that clean up after others come last.
        wait_until(lambda: not place.left(memory), 10)
        if left := place.left(memory):
            faults["left"] = left
    except subprocess.TimeoutExpired as error:
        faults["hang"] = [str(error)]
    finally:
        place.end()
        process.wait()
    if not found["faults"]:
        shutil.rmtree(place.folder, ignore_errors=True)
    return found


def wait_for_victims(
    place: Place, process: subprocess.Popen, target: str
) -> list[psutil.Process]:
    """Whom to kill: the first worker or engine that there is; nobody after the end."""
    word = {"worker": "spawn_main", "engine": ENGINE}.get(target.split()[0])
    while process.poll() is None:
        if word is None:
            return [psutil.Process(process.pid)]
        if victims := place.processes(word):
            return victims[-1:]
    return []


def strike(
    victims: list[psutil.Process], process: subprocess.Popen, target: str
) -> None:
    """Send the signal of a target."""
    whom, _, name = target.partition(" ")
    number = signal.Signals[name]
    for victim in victims:
        if whom == "group":
            os.killpg(process.pid, number)
        else:
            victim.send_signal(number)


def judge(
    place: Place, process: subprocess.Popen, name: str, target: str
) -> dict[str, Any]:
    """The faults of a run that was struck, before its resume."""
    faults: dict[str, Any] = {}
    # Engines of a killed process are ended by the next start.
    if not wait_until(lambda: not place.processes(but=ENGINE), END_S):
        alive = place.processes(but=ENGINE)
        faults["hang"] = [" ".join(one.cmdline())[:200] for one in alive]
        place.end()
    status, said = process.wait(), place.said("first")
    last = (said.strip().splitlines() or [""])[-1]
    sentence = last.startswith((f"{name.split()[0]}: ", "stopped; "))
    silent = status not in (0, -signal.SIGKILL) and not sentence
    # SIGTERM is not answered where there is nothing to save yet.
    if silent and status == 128 + signal.SIGTERM and "SIGTERM" in target:
        silent = False
    if "Traceback" in said or silent:
        faults["traceback"] = f"[{status}] {brief(said)}"
    if broken := broken_files(place.run, cut=True):
        faults["broken"] = broken
    return faults


def brief(said: str) -> str:
    """The end of what a run said, without its progress bars and the place of Python."""
    lines = [line for line in said.splitlines() if "%|" not in line and line.strip()]
    return "\n".join(lines).replace(sys.base_prefix, "")[-1500:]


def resume(place: Place, name: str, again: list[str], faults: dict[str, Any]) -> str:
    """Go on with a run: ``resumed``, ``again`` after a refusal, or ``failed``."""
    had, recipe = (place.run / "checkpoint.pt").exists(), name.split()[0]
    how = "resumed"
    status = place.start([recipe, f"resume={place.run}"], how, ROOT).wait(LIMIT_S)
    if status == 2 and not had and len(place.said(how).strip().splitlines()) == 1:
        how = "again"
        status = place.start(again, how, ROOT).wait(LIMIT_S)
    said = place.said(how)
    if status != 0:
        faults["resume"] = f"[{status}] {brief(said)}"
        return "failed"
    if "Traceback" in said:
        faults["traceback"] = brief(said)
    if broken := broken_files(place.run):
        faults["broken"] = broken
    if stray := temporary_files(place.run):
        faults["stray"] = stray
    return how


def _shared_memory() -> list[str]:
    folder = Path("/dev/shm")
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def _mapped() -> set[str]:
    """Names of the shared memory that a living process uses."""
    found = set()
    for process in psutil.process_iter():
        try:
            files = [one.path for one in process.memory_maps()]
        except (psutil.Error, OSError):
            continue
        found |= {Path(one).name for one in files if one.startswith("/dev/shm/")}
    return found


# ---------------------------------------------------------------- files


def _read_pt(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
    torch.load(path, weights_only=True)


def _read_csv(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    assert len({len(row) for row in csv.reader(text.splitlines())}) == 1


def _read_picture(path: Path) -> None:
    with Image.open(path) as picture:
        picture.load()


READERS: dict[str, Callable[[Path], object]] = {
    ".pt": _read_pt,
    ".zip": load_map,
    ".npy": np.load,
    ".csv": _read_csv,
    ".png": _read_picture,
    ".yaml": lambda path: yaml.safe_load(path.read_text()),
    ".json": lambda path: json.loads(path.read_text()),
    ".mp4": lambda path: iio.imread(path)[0],
    ".log": Path.read_text,
    ".lock": Path.read_bytes,
    # What of it counts is in the checkpoint, whose reader compares checksums.
    ".bin": Path.read_bytes,
}


def temporary_files(folder: Path) -> list[str]:
    """Hidden files, which become others once they are whole; locks are none."""
    found = [path for path in folder.rglob(".*") if path.name != ".lock"]
    return sorted(str(path.relative_to(folder)) for path in found)


def broken_files(folder: Path, *, cut: bool = False) -> list[str]:
    """Files that their reader refuses, or that have none.

    With ``cut``, those that grow line by line may end anywhere: the resume deals with
    them.
    """
    found, temporary = [], temporary_files(folder)
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() or name in temporary or "tfevents" in path.name:
            continue
        if cut and name.startswith("logs/"):
            continue
        try:
            READERS[path.suffix or path.name](path)
        except Exception as error:  # whatever a reader says
            found.append(f"{name}: {type(error).__name__} {error}"[:200])
    return found


# ---------------------------------------------------------------- many at once


def run_together(work: Path) -> dict[str, Any]:
    """Six explorations and 24 tours, all at once."""
    return start_together(work / "together", [EXPLORE_FROM_NOTHING] * 6 + [TOUR] * 24)


def start_together(folder: Path, commands: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Start all of them in one directory; how they ended, and what they left."""
    shutil.rmtree(folder, ignore_errors=True)
    place, began = Place(folder), time.monotonic()
    memory = set(_shared_memory())
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


# ---------------------------------------------------------------- all cases


def run_cases(
    kills: int, work: Path, only: Sequence[int] | None = None
) -> list[dict[str, Any]]:
    """Cases until so many runs were killed; finished ones of ``work`` count."""
    file = work / "cases.jsonl"
    done = (
        [json.loads(line) for line in file.read_text().splitlines()]
        if file.exists()
        else []
    )
    if not kills and not only:
        return done
    networks, seconds = prepare(work)
    known = {one["case"] for one in done}
    numbers = iter(only or range(100 * (kills + 1)))
    count = sum(one["killed"] for one in done)
    with tqdm(total=len(only) if only else kills, initial=count, unit="kill") as bar:
        while only or count < kills:
            if (number := next(numbers, None)) is None:
                break
            if number in known and not only:
                continue
            began = time.monotonic()
            found = run_case(number, work, networks, seconds)
            found["wall_s"] = round(time.monotonic() - began, 1)
            done.append(found)
            with file.open("a") as lines:
                lines.write(json.dumps(found) + "\n")
            count += found["killed"]
            bar.update(found["killed"])
            if found["faults"]:
                bar.write(
                    f"{number} {found['run']}, {found['target']}: {found['faults']}"
                )
    return done


def table(cases: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Counts by target: kills, faults of each kind, and how the resumes ended."""
    rows: dict[str, dict[str, int]] = {}
    for target in (*TARGETS, "all"):
        mine = [
            one for one in cases if one["killed"] and target in (one["target"], "all")
        ]
        faults = Counter(fault for one in mine for fault in one["faults"])
        resumes = Counter(one.get("resume") for one in mine)
        rows[target] = {
            "kills": len(mine),
            **{fault: faults[fault] for fault in FAULTS},
            "resumed": resumes["resumed"],
            "started_again": resumes["again"],
        }
    return rows


def hardware() -> dict[str, Any]:
    """What it ran on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": psutil.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9),
        "load": [round(one, 1) for one in os.getloadavg()],
    }


def commit() -> str:
    """The version of the code, with a mark if it has been changed since."""
    git = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    return subprocess.run(
        git, capture_output=True, text=True, check=False
    ).stdout.strip()


def main() -> None:
    """Run the cases and write the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--together", action="store_true")
    parser.add_argument("--work", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp(prefix="toponav-faults-"))
    work = work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    cases = run_cases(arguments.kills, work, arguments.only)
    seconds = work / "seconds.json"  # written before the first kill
    found: dict[str, Any] = {
        "commit": commit(),
        "command": " ".join(["python", "benchmarks/faults.py", *sys.argv[1:]]),
        "hardware": hardware(),
        "by_target": table(cases),
        "by_run": dict(Counter(one["run"] for one in cases if one["killed"])),
        "core_seconds_undisturbed": json.loads(seconds.read_text())
        if seconds.is_file()
        else {},
        "cases": sorted(one["case"] for one in cases if one["killed"]),
        "minutes": round(sum(one["wall_s"] for one in cases) / 60, 1),
        "faults": [one for one in cases if one["faults"]],
    }
    if arguments.together:
        found["together"] = run_together(work)
    print(json.dumps({k: v for k, v in found.items() if k != "faults"}, indent=1))
    if arguments.out:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
