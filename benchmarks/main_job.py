r"""The main job as users run it, from nothing: how long each phase takes, and why.

    python benchmarks/main_job.py --mazes maze3 --seeds 101 102 103 \
        --out results/main_job.json
    python benchmarks/main_job.py --seeds 101 --again --out results/second_run.json
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
are finished are not made again. With ``--again`` each is followed by another one with
another seed, which finds its networks and blind baselines: what a second run saves.
"""

import argparse
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import torch
from explore_speed import best_seconds, compose_settings, make_settings, measure
from pose_maps import restore
from torch.utils.flop_counter import FlopCounterMode

from toponav.builders import PLACES_FILE, make_autocast, make_networks, prepare_process
from toponav.config import ExploreConfig, PretrainConfig
from toponav.graph.poses import BEARINGS, DISTANCES
from toponav.methods import make_world
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork
from toponav.reports import EVALUATE, EXPLORE, PRETRAIN
from toponav.training import GroundRules, OffsetRules, PlaceRules

#: Added to the seed of a second run.
AGAIN = 1000
ROOT = Path(__file__).resolve().parent.parent
#: What is waited for: coverage and a map of a random walk, while the networks train;
#: coverage and the map of the exploration.
PICTURES = {
    "pre-train": ["-pretrain/*/walk.png"],
    "explore": ["/curves.png", "/map.png", "/topology.png"],
}


def run(
    maze: str, seed: int, work: Path, overrides: list[str], *, again: bool = False
) -> dict[str, Any]:
    """One main job; its folder keeps what it wrote, and what was measured of it.

    With ``again`` it is one more, with another seed of exploring, which finds the
    networks and the blind baselines of the first one.
    """
    first = work / f"{maze}-{seed}"
    folder = Path(f"{first}-again") if again else first
    kept = Path(f"{folder}.json")
    if kept.is_file():
        return json.loads(kept.read_text()) | kept_policy(folder)
    # What one that was cut off has left would be found again, or refused.
    for one in ("",) if again else ("", "-pretrain", "-random"):
        shutil.rmtree(f"{folder}{one}", ignore_errors=True)
    own = seed + AGAIN if again else seed
    words = [f"maze={maze}", "reward.alpha=0.2", f"seed={own}"]
    words += [f"pretraining.seed={seed}", *overrides]
    paths = [f"pretraining.folder={first}-pretrain", f"hydra.run.dir={folder}"]
    paths += [f"evaluate.random_folder={first}-random"]
    command = [sys.executable, str(ROOT / "recipes" / "explore.py"), *words, *paths]
    began, load, samples = time.time(), os.getloadavg()[0], []
    spent = processor_seconds()
    pictured: dict[str, float] = {}
    with Path(f"{folder}.log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        while process.poll() is None:
            times = psutil.cpu_times()
            samples.append((time.time(), times.idle + times.iowait, sum(times[:8])))
            for name, files in PICTURES.items():
                if name not in pictured and all(
                    any(work.glob(f"{folder.name}{one}")) for one in files
                ):
                    pictured[name] = time.time() - began
            time.sleep(0.5)
    ended = time.time()
    if process.returncode:
        raise SystemExit(f"{maze}, seed {seed}: exit status {process.returncode}")
    found = {"maze": maze, "seed": seed, "settings": words, "load_before": load}
    found |= {"minutes": (ended - began) / 60, "first_pictures_after_s": pictured}
    used = processor_seconds() - spent
    found["busy_by_itself"] = used / (ended - began) / len(os.sched_getaffinity(0))
    found |= read_run(folder, samples)
    kept.write_text(json.dumps(found, indent=1))
    return found | kept_policy(folder)


def processor_seconds() -> float:
    """Of all that was started from here and has ended, engines included."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def kept_policy(folder: Path) -> dict[str, Any]:
    """Which policy a finished run kept, the one evaluated first, and its coverage."""
    rows = pd.read_csv(folder / "evaluation.csv")
    name = rows["policy"].iloc[0]
    covered = rows["coverage"][rows["policy"] == name].mean()
    return {"kept": name, "kept_coverage": covered}


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


def operations(call: Callable[[], torch.Tensor]) -> float:
    """Operations of a call and of its gradients."""
    with FlopCounterMode(display=False) as counter:
        call().sum().backward()
    return float(counter.get_total_flops())


def roofs(
    explore: ExploreConfig, pretrain: PretrainConfig, finished: Path
) -> dict[str, dict[str, float]]:
    """Seconds of the parts of each phase, on all cores, if nothing else were done.

    The parts of a phase add up to its roof. Poses, which are no products of networks,
    take what they take alone; they are found for the views of a ``finished`` run.
    """
    bf16 = make_autocast(torch.device("cpu"), bf16=True).__class__ is torch.autocast
    rate, cores = product_rate(bf16=bf16), len(os.sched_getaffinity(0))
    prepare_process(threads=1)
    world = make_world(explore)
    networks = make_networks(explore.model, world.spec)
    timed = measure(explore, 10.0)["parts"]
    parts = {name: seconds["core"] for name, seconds in timed.items()}

    pairs, width, many = pretrain.pairs, explore.model.embedding_dim, torch.zeros
    views = torch.zeros(8, *networks.view_size, 3, dtype=torch.uint8)
    embed = operations(lambda: networks.tc.encoder(views)) / 8
    compare = operations(lambda: networks.tc.comparator(many(8, width), many(8, width)))
    head = operations(lambda: networks.locomotion.head(many(8, width), many(8, width)))
    embedded = pairs.episodes * pairs.chunks * pairs.chunk_len * embed
    compared = pairs.per_update * (compare + head) / 8
    walked = pretrain.collect.decisions
    walked += pretrain.validate.episodes * pretrain.validate.decisions
    played = 2 * explore.evaluate.episodes * world.episode_length
    found = {
        PRETRAIN: {
            "embed": pretrain.train.updates * embedded / rate,
            "compare": pretrain.train.updates * compared / rate,
            "engines": walked * parts["engines"] / cores,
        },
        EXPLORE: {
            name: explore.collect.decisions * seconds / cores
            for name, seconds in parts.items()
        },
        EVALUATE: {
            name: played * seconds / cores
            for name, seconds in parts.items()
            if name != "learn"
        },
    }
    by_poses = (finished / PLACES_FILE).is_file()
    if explore.trains_head(by_poses=by_poses):
        tuned = explore.locomotion.updates * explore.locomotion.pairs * head / 8
        found[EVALUATE]["head"] = tuned / rate
    if by_poses:
        found[EVALUATE] |= map_parts(finished, rate=rate)
    return found


def map_parts(finished: Path, *, rate: float) -> dict[str, float]:
    """Seconds on all cores of a map by poses, and of what views say on it."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "run"
        shutil.copytree(finished, copy, ignore=shutil.ignore_patterns("logs"))
        growth, _ = restore(copy, copy, None)
        began = time.process_time()
        views = growth.consolidate()
        spent = time.process_time() - began
    assert views is not None
    width = views[0].shape[1]
    sizes, views_of_8 = (growth.map.num_waypoints, width), torch.zeros(8, width)
    ground = GroundNetwork(width, len(BEARINGS), len(DISTANCES))
    learned = [(PlaceNetwork(*sizes), PlaceRules()), (ground, GroundRules())]
    learned.append((OffsetNetwork(*sizes), OffsetRules()))
    needed = sum(
        operations(lambda one=one: one(views_of_8)) / 8 * rules.views * rules.updates
        for one, rules in learned
    )
    cores = len(os.sched_getaffinity(0))
    return {"poses": spent / cores, "places": needed / rate}


def main() -> None:
    """Run the main jobs, one after the other, and write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mazes", nargs="+", default=["maze3"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[101, 102, 103])
    parser.add_argument(
        "--again", action="store_true", help="each a second time, with what is kept"
    )
    parser.add_argument("--work", type=Path, default=Path("runs/main_job"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    arguments = parser.parse_args()
    work = arguments.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    runs = [
        run(maze, seed, work, arguments.overrides)
        for maze in arguments.mazes
        for seed in arguments.seeds
    ]
    # The memories of a profile are full, as they are for most of a run.
    explore = make_settings("laptop", ["maze=maze3", *arguments.overrides])
    last = arguments.work / f"{arguments.mazes[-1]}-{arguments.seeds[-1]}"
    least = roofs(explore, compose_settings("pretrain", ["maze=maze3"]), last)
    second = [
        run(maze, seed, work, arguments.overrides, again=True)
        for maze in arguments.mazes
        for seed in arguments.seeds
        if arguments.again
    ]
    # The mean over the runs, against the roof of the phase.
    phases = {}
    for name, parts in least.items():
        if name not in runs[0]["phases"]:  # networks were given
            continue
        took = [one["phases"][name]["seconds"] for one in runs]
        busy = [one["phases"][name]["busy"] for one in runs]
        mean = sum(took) / len(took)
        phases[name] = {"seconds": mean, "busy": sum(busy) / len(busy)}
        roof = sum(parts.values())
        phases[name] |= {"roof_seconds": roof, "share_of_roof": roof / mean}
        shares = {part: seconds / mean for part, seconds in parts.items()}
        phases[name] |= {"parts_at_roof_s": parts, "parts_of_phase": shares}
    found = {
        "minutes": sum(one["minutes"] for one in runs) / len(runs),
        "phases": phases,
        "runs": runs,
        "second_runs": second,
        "cores": len(os.sched_getaffinity(0)),
        "processor": platform.processor() or platform.machine(),
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=1))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
