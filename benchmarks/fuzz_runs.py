"""Damaged texts that runs leave, for `fuzz`: tables, logs, layouts, baselines."""

import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz_cases import Accepted, Case, require_same
from fuzz_damage import damage
from fuzz_given import played, ring_words
from fuzz_settings import run_recipe

from tests.composed import settings
from toponav.config import ExploreConfig, SettingsError
from toponav.experiments import found_runs
from toponav.methods import make_world
from toponav.reports import Baselines, baselines
from toponav.runs import make_loggers, read_table, write_history

#: What no text of a run holds, to stand anywhere in it.
ODD = {
    "no text": b"\xff",
    "zeros": b"\n\0\0\0\n",
    "deep": b"[" * 100_000,
    "long": b"1" * 200_000,
    **{repr(one): one.encode() for one in ('"', ",", "\n", "\r", ";", "\ufeff")},
}
#: Runs of `played`, and their tables that others read.
TABLES = {
    "pretrained": ("metrics.csv",),
    "explored": ("evaluation.csv", "episodes.csv", "metrics.csv", "map.csv"),
    "navigated": ("episodes.csv",),
}
#: Names of runs in a folder of sweeps.
WHOLE, DAMAGED = "whole", "damaged"
# The last step of a log that is kept, in the middle of the exploration.
_LAST = 512


def run_case(number: int, draw: random.Random, work: Path) -> Case:
    """A text of a run in a ring with other bytes. It has no checksum.

    Other numbers in the place of its own are read as such; whatever else it holds, the
    run is left out of tables, its layout refused, and its logs and times are no reason
    to refuse.
    """
    makers = [table_case, table_case, report_case, log_case, layout_case]
    return draw.choice([*makers, times_case, baselines_case])(number, draw, work)


def table_case(number: int, draw: random.Random, work: Path) -> Case:
    """A table of one of two runs that `report` or `reproduce` reads."""
    name = draw.choice(sorted(TABLES))
    return summary_case(number, draw, work, name, draw.choice(TABLES[name]))


def report_case(number: int, draw: random.Random, work: Path) -> Case:
    """The same with the ``report.json`` of a pre-training."""
    return summary_case(number, draw, work, "pretrained", "report.json")


def summary_case(
    number: int, draw: random.Random, work: Path, name: str, file: str
) -> Case:
    """A file of one of two runs in a folder of sweeps; the other one is whole."""
    sweep = work / f"sweep-{number}"
    kept = shutil.ignore_patterns("checkpoint.pt", "logs", "*.png", "*.mp4")
    for run in (WHOLE, DAMAGED):
        shutil.copytree(played() / name, sweep / run, ignore=kept)
    way = damage_text(sweep / DAMAGED / file, draw)
    reads = draw.choice([report, report, look_through])

    def run() -> None:
        with going_on():
            reads(sweep)

    kind = "report.json" if file == "report.json" else "table"
    return Case(number, kind, f"{reads.__name__} {name} {file} {way}", run)


def report(sweep: Path) -> None:
    """The recipe: the run that is whole counts in any case."""
    run_recipe("report", ["draws=10", f"folder={sweep}"])


def look_through(sweep: Path) -> None:
    """What `reproduce` asks of all runs that are there."""
    found_runs.find_keys(sweep)
    found_runs.find_mapped(sweep)
    for run in (WHOLE, DAMAGED):
        found_runs.is_finished(sweep / run)
        found_runs.seconds_of(sweep / run)
        found_runs.decisions_of(sweep / run)


def log_case(number: int, draw: random.Random, work: Path) -> Case:
    """A log of a run that is resumed; its whole rows, and they alone, are kept."""
    name = draw.choice(["explored", "pretrained"])
    folder = work / f"resumed-{number}"
    shutil.copytree(played() / name, folder)
    file = draw.choice(sorted(folder.glob("logs/**/*.*")))
    way = damage_text(file, draw)

    def run() -> None:
        with going_on():
            make_loggers(folder, _LAST)
        require_same(file.suffix != ".csv" or all(map(is_row, lines_of(file))))
        if name == "pretrained":
            with going_on():
                run_recipe(*resuming("pretrain", folder))

    return Case(number, "log", f"{name} {file.stem} {way}", run, folder)


def lines_of(file: Path) -> list[str]:
    """The rows of a log, which is text by now."""
    return file.read_text(encoding="utf-8").splitlines()


def is_row(line: str) -> bool:
    """Whether it is a row of a log that is kept: a step and a number."""
    step, value = line.split(",")
    float(value)
    return int(step) <= _LAST


def times_case(number: int, draw: random.Random, work: Path) -> Case:
    """``phases.csv`` of an exploration that is resumed."""
    folder = work / f"resumed-{number}"
    shutil.copytree(played() / "explored", folder)
    way = damage_text(folder / "phases.csv", draw)

    def run() -> None:
        with going_on():
            run_recipe(*resuming("explore", folder))

    return Case(number, "phases.csv", way, run, folder)


def layout_case(number: int, draw: random.Random, work: Path) -> Case:
    """The copy of a layout that a resume, a navigation or a practice compares."""
    recipe = draw.choice(["explore", "pretrain", "navigate", "practise"])
    folder = work / f"resumed-{number}"
    name = "pretrained" if recipe == "pretrain" else "explored"
    shutil.copytree(played() / name, folder)
    file = folder / "config" / "layout.txt"
    whole = file.read_text()
    way = damage_text(file, draw)

    def run() -> None:
        try:
            if recipe in ("explore", "pretrain"):
                run_recipe(*resuming(recipe, folder))
            else:
                words = [f"run={folder}", f"hydra.run.dir={work / 'run'}"]
                run_recipe(recipe, ["scale=smoke", *words])
        except Accepted:
            # Its lines may end in any way.
            require_same(file.read_text() == whole)
            raise

    return Case(number, "layout.txt", f"{recipe} {way}", run, folder)


def resuming(recipe: str, folder: Path) -> tuple[str, list[str]]:
    """A recipe, and the words that have it go on with its run."""
    return recipe, [f"resume={folder}"]


def baselines_case(number: int, draw: random.Random, work: Path) -> Case:
    """Kept blind baselines: they are found as rows of a table, or played again."""
    kept = work / f"baselines-{number}"
    shutil.copytree(played() / "runs" / "baselines", kept)
    words = ("scale=smoke", *ring_words(played()), f"evaluate.random_folder={kept}")
    found = settings("explore", *words)
    assert isinstance(found, ExploreConfig)
    world = make_world(found)
    way = damage_text(baselines.baselines_file(found, world), draw)

    def run() -> None:
        rows = baselines.find_baselines(found, world)
        if rows is None:
            return
        levels = Baselines(found, world).levels()
        require_same(all(0 <= level <= 1 for level in levels.values()))
        write_history(table := work / "evaluation.csv", rows)
        read_table(table, ("policy", *(name for name in rows[0] if name != "policy")))

    return Case(number, "baselines", way, run)


def damage_text(path: Path, draw: random.Random) -> str:
    """Damage it as any file, or put something odd anywhere in it; returns how."""
    way = draw.choice(["flip", "flip", "cut", "insert", "text", *["odd"] * 3])
    if way != "odd":
        damage(path, way, draw)
        return way
    way, data = draw.choice(sorted(ODD)), path.read_bytes()
    at = draw.choice([0, len(data), *[draw.randrange(len(data))] * 3])
    path.write_bytes(data[:at] + ODD[way] + data[at:])
    return f"{way} at {at}"


@contextmanager
def going_on() -> Iterator[None]:
    """What is damaged is no reason to refuse: other runs and other files count."""
    try:
        yield
    except (SettingsError, SystemExit) as end:
        if isinstance(end, SettingsError) or end.code:
            raise RuntimeError("it was a reason to refuse") from end
