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
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fault_kills import TARGETS, run_case
from fault_runs import prepare
from fault_together import run_together
from made_by import commit, hardware
from tqdm import tqdm

FAULTS = ("hang", "traceback", "broken", "stray", "left", "resume")


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
