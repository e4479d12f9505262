"""One case of `faults`: a run is killed, looked at and resumed."""

import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
from fault_files import broken_files, temporary_files
from fault_place import END_S, LIMIT_S, ROOT, Place, shared_memory, wait_until
from fault_runs import RUNS, command

TARGETS = (
    *("main SIGKILL", "group SIGKILL", "worker SIGKILL", "engine SIGKILL"),
    *("main SIGTERM", "main SIGINT", "group SIGINT"),
)
#: What the command line of an engine has in it.
ENGINE = "engine.ini"


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
    memory = set(shared_memory())
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
    recipe = name.split()[0]
    sentence = last.startswith("stopped; ") or last == f"{recipe}: stopped by Ctrl-C"
    # One that lost a process says which; a signal to the run itself is no other fault.
    if target.split()[0] in {"worker", "engine"}:
        sentence = sentence or last.startswith(f"{recipe}: ")
    silent = status not in (0, -signal.SIGKILL) and not sentence
    # SIGTERM is not answered where there is nothing to save yet.
    if silent and status == 128 + signal.SIGTERM and "SIGTERM" in target:
        silent = False
    if "Traceback" in said or silent:
        faults["traceback"] = f"[{status}] {brief(said)}"
    if broken := [bad for one in place.runs for bad in broken_files(one, cut=True)]:
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
    if broken := [bad for one in place.runs for bad in broken_files(one)]:
        faults["broken"] = broken
    if stray := [half for one in place.runs for half in temporary_files(one)]:
        faults["stray"] = stray
    return how
