"""Bad layouts, settings and files by the thousand: what the package says to each.

    PYTHONPATH=. python benchmarks/fuzz.py --out results/fuzz.json

Every case is made from its own number, so that one that fails can be run alone
(``--only 17``). A third are layouts, a third command lines of the recipes, a third
damaged files: maps and what lies beside them, networks, policies, practices,
checkpoints, run folders, and tables, reports, logs, copies of layouts and baselines of
runs that are played first. Recipes that start from finished runs get such, so that what
is drawn decides. Each runs in a child process with a limit of time and memory, up
to where engines would start, and ends in one of these:

* ``refused``: one sentence, and nothing is left; of a sweep (``-m``) with several
  jobs, which go on after one that is refused, one sentence each and a last line that
  says so;
* ``accepted``: it is valid, or what is damaged in it does not count;
* ``traceback``: anything else was printed, or a wrong type of error came out;
* ``hang``: it took longer than the limit, not counting waits for a core;
* ``changed``: it was accepted although what was read is not what was written;
* ``litter``: it was refused, and left something, such as a run folder.

The last four are faults; they are listed with what was printed.
"""

import argparse
import importlib
import json
import multiprocessing.util
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from fuzz_cases import ACCEPTED, CHANGED, RAISED, Accepted, Case
from fuzz_files import file_case
from fuzz_layouts import layout_case
from fuzz_settings import USUAL, learn_keys, settings_case
from made_by import commit, hardware
from tqdm import tqdm

from toponav.config import SettingsError
from toponav.graph import MapFileError

#: Seconds and bytes of a case; a valid one of 1,000 episodes takes 17 s alone.
LIMIT_S, LIMIT_BYTES = 90.0, 12 * 2**30
GOOD, FAULTS = ("refused", "accepted"), ("traceback", "hang", "changed", "litter")
MAKERS = (layout_case, settings_case, file_case)


def make_case(number: int, work: Path) -> Case:
    """The case of a number: always the same one."""
    draw = random.Random(number)
    return MAKERS[number % len(MAKERS)](number, draw, work)


def outcome(case: Case, work: Path) -> tuple[str, str]:
    """Run a case in a child process; how it ended, and what it printed."""
    said = work / "said.txt"
    before = {said, *work.rglob("*")}
    child = os.fork()
    if child == 0:
        run_child(case, said, work)
    started, status = time.monotonic(), None
    while status is None and time.monotonic() - started - waited_s(child) < LIMIT_S:
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
    if code == CHANGED:
        return "changed", text
    if code in (0, ACCEPTED):
        return "accepted", text
    if not is_refusal(text) or code not in (1, 2, RAISED):
        return "traceback", f"[{code}] {text[-1500:]}"
    if any(case.resumed not in path.parents for path in {*work.rglob("*")} - before):
        return "litter", text
    return "refused", text


def waited_s(process: int) -> float:
    """Seconds that a process was ready and had no core, which a busy machine costs."""
    try:
        return int(Path(f"/proc/{process}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, IndexError):  # it has ended, or the system does not say
        return 0.0


def is_refusal(text: str) -> bool:
    r"""Whether one sentence was printed, or those of a sweep with several jobs.

    Examples:
        >>> is_refusal("tour: seed must be 0"), is_refusal("one\ntwo")
        (True, False)
        >>> is_refusal("tour: ")  # says nothing
        False
    """
    lines = text.splitlines()
    if len(lines) > 1 and lines[-1].endswith(": not all jobs of the sweep succeeded"):
        # Each ends with the job's settings.
        return all(re.match(r"\w+: .*\(.*\)$", line) for line in lines[:-1])
    says = len(lines) == 1 and not re.fullmatch(r"\w+:\s*", text)
    return says and "Traceback" not in text


def run_child(case: Case, said: Path, work: Path) -> None:
    """Run a case with limits, and end the process by what came of it."""
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    os.chdir(work)
    errors = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(errors, 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.stderr = os.fdopen(2, "w", buffering=1)
    code = ACCEPTED
    try:
        case.run()
    except (Accepted, KeyboardInterrupt):
        pass
    except SystemExit as end:
        code = int(end.code or 0)
    except (SettingsError, MapFileError) as error:
        print(error, file=sys.stderr)
        code = RAISED
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
        for number in tqdm(numbers, unit="case", disable=None):
            case = make_case(number, work)
            started = time.monotonic()
            how, text = outcome(case, work)
            slowest = max(slowest, time.monotonic() - started)
            counts.setdefault(case.kind, Counter())[how] += 1
            if how in FAULTS:
                faults.append(
                    {"case": number, "how": how, "what": case.what, "said": text}
                )
                tqdm.write(f"{number} {how}: {case.what}\n    {text[-300:]}")
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
    learn_keys()


def main() -> None:
    """Run the cases and write the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    prepare()
    started = time.monotonic()
    found = {
        "commit": commit(),
        "hardware": hardware(),
        **run_cases(arguments.only or range(arguments.cases)),
    }
    found["minutes"] = round((time.monotonic() - started) / 60, 1)
    print(
        json.dumps({name: found[name] for name in found if name != "faults"}, indent=1)
    )
    if arguments.out:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
