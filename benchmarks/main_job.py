r"""The main job as users run it, from nothing: how long each phase takes, and why.

    python benchmarks/main_job.py --mazes maze3 --seeds 101 102 103 \
        --out results/main_job.json
    python benchmarks/main_job.py --seeds 101 --work runs/first_look --out \
        results/first_look.json pretrained=package:maze3 collect.decisions=40000 \
        evaluate.episodes=2 evaluate.random_episodes=2

``recipes/explore.py maze=... reward.alpha=0.2`` runs in a process of its own with empty
folders, so that nothing is found again: it pre-trains, explores with map, log, pictures
and checkpoints, makes its map, and evaluates. Beside the seconds of each
phase stands the share of all cores that were busy, when the first pictures came, what
the run reached, and the share of a roof: what the phase would take if all cores did
nothing but the products of its networks (in the faster precision, at the rate of one
large product) and the engines' decisions. All are means over whole phases. Runs that
are finished are not made again.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import torch
from explore_speed import best_seconds, compose_settings, make_settings, measure
from torch.utils.flop_counter import FlopCounterMode

from toponav.builders import make_autocast, make_networks, prepare_process
from toponav.config import ExploreConfig, PretrainConfig
from toponav.methods import make_world
from toponav.reports import EVALUATE

ROOT = Path(__file__).resolve().parent.parent
#: What is waited for: coverage and a map of a random walk, while the networks train;
#: coverage and the map of the exploration.
PICTURES = {
    "pre-train": ["-pretrain/*/walk.png"],
    "explore": ["/curves.png", "/map.png", "/topology.png"],
}


def run(maze: str, seed: int, work: Path, overrides: list[str]) -> dict[str, Any]:
    """One main job; its folder keeps what it wrote, and what was measured of it."""
    folder, kept = work / f"{maze}-{seed}", work / f"{maze}-{seed}.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    # What one that was cut off has left would be found again, or refused.
    for one in ("", "-pretrain", "-random"):
        shutil.rmtree(f"{folder}{one}", ignore_errors=True)
    words = [f"maze={maze}", "reward.alpha=0.2", f"seed={seed}"]
    words += [f"pretraining.seed={seed}", *overrides]
    paths = [f"pretraining.folder={folder}-pretrain", f"hydra.run.dir={folder}"]
    paths += [f"evaluate.random_folder={folder}-random"]
    command = [sys.executable, str(ROOT / "recipes" / "explore.py"), *words, *paths]
    began, load, samples = time.time(), os.getloadavg()[0], []
    first: dict[str, float] = {}
    with Path(f"{folder}.log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        while process.poll() is None:
            times = psutil.cpu_times()
            samples.append((time.time(), times.idle + times.iowait, sum(times[:8])))
            for name, files in PICTURES.items():
                if name not in first and all(
                    any(work.glob(f"{folder.name}{one}")) for one in files
                ):
                    first[name] = time.time() - began
            time.sleep(0.5)
    ended = time.time()
    if process.returncode:
        raise SystemExit(f"{maze}, seed {seed}: exit status {process.returncode}")
    found = {"maze": maze, "seed": seed, "settings": words, "load_before": load}
    found |= {"minutes": (ended - began) / 60, "first_pictures_after_s": first}
    found |= read_run(folder, samples)
    kept.write_text(json.dumps(found, indent=1))
    return found


def read_run(folder: Path, samples: list[tuple[float, ...]]) -> dict[str, Any]:
    """What a finished run's files say, and how busy the cores were meanwhile."""
    table = pd.DataFrame(samples, columns=["time", "idle", "all"])

    def busy(begin: float, end: float) -> float:
        inside = table[table["time"].between(begin, end)]
        spent = inside[["idle", "all"]].iloc[[0, -1]].diff().iloc[-1]
        return 1 - spent["idle"] / spent["all"]

    rows = pd.read_csv(folder / "phases.csv")
    # The file is written when the last phase ends.
    began = (folder / "phases.csv").stat().st_mtime - rows["ended"].iloc[-1]
    phases = {
        row.phase: {
            "seconds": row.seconds,
            "busy": busy(began + row.ended - row.seconds, began + row.ended),
        }
        for row in rows.itertuples()
    }
    metrics = pd.read_csv(folder / "metrics.csv").iloc[-1]
    last_map = pd.read_csv(folder / "map.csv").iloc[-1]
    played = pd.read_csv(folder / "evaluation.csv").groupby("policy")["coverage"]
    shown = ("waypoints", "coverage", "true_components", "false_edges", "stretch")
    return {
        "phases": phases,
        "busy": busy(table["time"].min(), table["time"].max()),
        "exploring_decisions_per_second": metrics["decisions"] / metrics["seconds"],
        "coverage": played.mean().to_dict(),
        "map": {name: float(last_map[name]) for name in shown if name in last_map},
    }


def product_rate(*, bf16: bool) -> float:
    """Operations a second of one large product on all cores."""
    prepare_process(threads=len(os.sched_getaffinity(0)))
    one = torch.randn(2048, 2048, dtype=torch.bfloat16 if bf16 else torch.float32)
    return 2 * 2048**3 / best_seconds(lambda: one @ one)


def roofs(explore: ExploreConfig, pretrain: PretrainConfig) -> dict[str, float]:
    """Seconds of each phase if all cores did nothing but what must be done."""
    bf16 = make_autocast(torch.device("cpu"), bf16=True).__class__ is torch.autocast
    rate, cores = product_rate(bf16=bf16), len(os.sched_getaffinity(0))
    prepare_process(threads=1)
    world = make_world(explore)
    networks = make_networks(explore.model, world.spec)
    parts = measure(explore, 10.0)["parts"]

    def operations(call: Any) -> float:
        with FlopCounterMode(display=False) as counter:
            call().sum().backward()
        return counter.get_total_flops()

    pairs, width, many = pretrain.pairs, explore.model.embedding_dim, torch.zeros
    views = torch.zeros(8, *networks.view_size, 3, dtype=torch.uint8)
    embed = operations(lambda: networks.tc.encoder(views)) / 8
    compare = operations(lambda: networks.tc.comparator(many(8, width), many(8, width)))
    head = operations(lambda: networks.locomotion.head(many(8, width), many(8, width)))
    per_update = pairs.episodes * pairs.chunks * pairs.chunk_len * embed
    per_update += pairs.per_update * (compare + head) / 8
    walked = pretrain.collect.decisions
    walked += pretrain.validate.episodes * pretrain.validate.decisions
    decision = sum(parts.values()) / cores
    played = 2 * explore.evaluate.episodes * world.episode_length
    trains_head = explore.trains_head(by_poses=explore.map.poses)
    tuned = explore.locomotion.updates * explore.locomotion.pairs * head / 8
    return {
        "pre-train": pretrain.train.updates * per_update / rate
        + walked * parts["engines"] / cores,
        "explore": explore.collect.decisions * decision,
        # Poses and the network of the map's places are left out.
        EVALUATE: tuned / rate * trains_head
        + played * (decision - parts["learn"] / cores),
    }


def main() -> None:
    """Run the main jobs, one after the other, and write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mazes", nargs="+", default=["maze3"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[101, 102, 103])
    parser.add_argument("--work", type=Path, default=Path("runs/main_job"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    runs = [
        run(maze, seed, arguments.work.resolve(), arguments.overrides)
        for maze in arguments.mazes
        for seed in arguments.seeds
    ]
    # The memories of a profile are full, as they are for most of a run.
    explore = make_settings("laptop", ["maze=maze3", *arguments.overrides])
    least = roofs(explore, compose_settings("pretrain", ["maze=maze3"]))
    # The mean over the runs, against the roof of the phase.
    phases = {}
    for name, roof in least.items():
        if name not in runs[0]["phases"]:  # networks were given
            continue
        took = [one["phases"][name]["seconds"] for one in runs]
        busy = [one["phases"][name]["busy"] for one in runs]
        mean = sum(took) / len(took)
        phases[name] = {"seconds": mean, "busy": sum(busy) / len(busy)}
        phases[name] |= {"roof_seconds": roof, "share_of_roof": roof / mean}
    found = {
        "minutes": sum(one["minutes"] for one in runs) / len(runs),
        "phases": phases,
        "runs": runs,
        "cores": len(os.sched_getaffinity(0)),
        "processor": platform.processor() or platform.machine(),
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=1))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
