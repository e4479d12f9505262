"""Cost of a reset, and memory over many decisions and resets.

    python benchmarks/reset_and_memory.py --out results/reset_and_memory.json

In each maze resets include goal and five apples; target at most 3 ms each. Then a batch
of 8 runs 100,000 decisions with 1,000 resets; resident memory of Python and of its
engines is printed along the way and should stay flat.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

import psutil
import torch

from toponav.envs import MAZES, MazeEnv, load_maze

BATCH = 8


def reset_milliseconds(maze: str, count: int) -> dict[str, float]:
    """Median and 95 % quantile of single resets."""
    env = MazeEnv(load_maze(maze), apples=5, goal=True)
    times = []
    try:
        for _ in range(count):
            start = time.perf_counter()
            env.reset()
            times.append(1e3 * (time.perf_counter() - start))
    finally:
        env.close()
    quantiles = statistics.quantiles(times, n=20)
    return {
        "resets": count,
        "median_ms": round(statistics.median(times), 2),
        "p95_ms": round(quantiles[-1], 2),
    }


def memory_growth(maze: str, decisions: int, resets: int) -> list[dict[str, float]]:
    """Resident memory in MB at ten moments of a long run."""
    episode = decisions // resets
    env = MazeEnv(
        load_maze(maze),
        batch_size=BATCH,
        apples=5,
        goal=True,
        episode_length=episode,
    )
    rows = []
    try:
        engines = [psutil.Process(pid) for pid in env.games.pids]
        data = env.reset()
        steps = decisions // BATCH
        for step in range(1, steps + 1):
            data["action"] = torch.randint(0, 6, (BATCH,))
            _, data = env.step_and_maybe_reset(data)
            if step % (steps // 10) == 0:
                engine = sum(process.memory_info().rss for process in engines)
                python = psutil.Process().memory_info().rss
                rows.append(
                    {
                        "decisions": step * BATCH,
                        "python_mb": round(python / 2**20, 1),
                        "engines_mb": round(engine / 2**20, 1),
                        "open_files": psutil.Process().num_fds(),
                    }
                )
                print(rows[-1], flush=True)
    finally:
        env.close()
    return rows


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mazes", nargs="+", choices=MAZES, default=[*MAZES][:3])
    parser.add_argument("--decisions", type=int, default=100_000)
    parser.add_argument("--resets", type=int, default=1_000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    found = {}
    for maze in options.mazes:
        found[maze] = {
            "reset": reset_milliseconds(maze, 500),
            "memory": memory_growth(maze, options.decisions, options.resets),
            "load": round(os.getloadavg()[0], 2),
        }
        print(maze, found[maze]["reset"], "load", found[maze]["load"], flush=True)
    if options.out:
        options.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
