"""The same exploration by local processes and by Ray, and by Ray while a node dies.

    python benchmarks/ray_pair.py --folder runs/ray --out results/ray.json

Two raylets of a core each on this machine are the cluster. For each seed
``recipes/explore.py`` runs with ``collect.backend=local`` and with ``ray``, one after
the other, and once more by Ray, where one of the two raylets is killed when half of the
decisions are made. The file has coverage (the mean of the last policy's episodes),
decisions, seconds and decisions/s of each run as its ``metrics.csv`` has them, and what
it said of the node. Other words are settings of the recipe.
"""

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

try:
    from ray.cluster_utils import Cluster
except ImportError:  # main says so
    Cluster = None

EXPLORE = Path(__file__).resolve().parent.parent / "recipes" / "explore.py"
SETTINGS = (
    *("maze=select", "pretrained=package:select", "collect.workers=2"),
    *("map.poses=false", "locomotion.learn=false", "report.every=2000"),
)
NODE = {"num_cpus": 1, "object_store_memory": 2 * 10**8}


def read_rows(file: Path) -> list[dict[str, str]]:
    """Rows of a table of a run; none before it is written."""
    if not file.is_file():
        return []
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def decisions_of(folder: Path) -> int:
    """How many decisions a run has made."""
    rows = read_rows(folder / "metrics.csv")
    return int(rows[-1]["decisions"]) if rows else 0


def explore(folder: Path, words: list[str], *, kill: Any = None, at: int = 0) -> Any:
    """Run the recipe; ``kill`` is called once it has made ``at`` decisions."""
    command = [sys.executable, str(EXPLORE), *SETTINGS, *words]
    log = folder.with_suffix(".log")
    with log.open("wb") as output:
        began = time.monotonic()
        run = subprocess.Popen(
            [*command, f"hydra.run.dir={folder}"], stdout=output, stderr=output
        )
        while run.poll() is None:
            if kill is not None and decisions_of(folder) >= at:
                kill()
                kill = None
            time.sleep(1.0)
    text = log.read_text(errors="replace").replace("\r", "\n")
    said = [line for line in text.splitlines() if "was lost with its" in line]
    if run.returncode:
        raise RuntimeError(f"{folder} ended with {run.returncode}: {text[-500:]}")
    last = read_rows(folder / "metrics.csv")[-1]
    scores = read_rows(folder / "evaluation.csv")
    covered = [float(row["coverage"]) for row in scores if row["policy"] == "last"]
    return {
        "coverage": statistics.mean(covered),
        "episodes": len(covered),
        "decisions": int(last["decisions"]),
        "seconds": float(last["seconds"]),
        "decisions_per_second": int(last["decisions"]) / float(last["seconds"]),
        "whole_run_seconds": time.monotonic() - began,
        "load": os.getloadavg()[0],
        "said": said,
    }


def main() -> None:
    """Make all runs, and write after each one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--decisions", type=int, default=40_000)
    parser.add_argument("--out", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    arguments = parser.parse_args()
    if Cluster is None:
        parser.error("Ray must be installed: pip install 'toponav[ray]'")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    folder, decisions = arguments.folder.resolve(), arguments.decisions
    found: dict[str, Any] = {"settings": [*SETTINGS, *arguments.overrides], "runs": []}

    def add(name: str, seed: int, words: list[str], **given: Any) -> None:
        words = [f"seed={seed}", f"collect.decisions={decisions}", *words]
        words += arguments.overrides
        made = explore(folder / f"{name}-{seed}", words, **given)
        found["runs"].append({"run": name, "seed": seed, **made})
        print(json.dumps(found["runs"][-1]), flush=True)
        if arguments.out is not None:
            arguments.out.write_text(json.dumps(found, indent=2) + "\n")

    for seed in arguments.seeds:
        add("local", seed, [])
    cluster = Cluster(initialize_head=True, head_node_args=NODE)
    try:
        node = cluster.add_node(**NODE)
        by_ray = ["collect.backend=ray", f"ray.address='{cluster.address}'"]
        for seed in arguments.seeds:
            add("ray", seed, by_ray)

        def kill() -> None:
            cluster.remove_node(node, allow_graceful=False)

        add("killed", arguments.seeds[0], by_ray, kill=kill, at=decisions // 2)
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()
