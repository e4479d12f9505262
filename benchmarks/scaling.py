r"""Exploration and its map in mazes from 11x13 to 41x41: what grows with the area.

    python benchmarks/scaling.py --out results/scaling.csv --figure results/scaling.png
    python benchmarks/scaling.py --sizes 5x6 8x8 --work runs/scaling

Each run is a main job from nothing in a generated maze (``benchmarks/main_job.py``): R
x C rooms make a plan of 2 R + 1 by 2 C + 1 cells, border included. Episodes grow with
the number of open cells, so that each cell has as many decisions as in the smallest
maze at 1,800; the memory of an episode has room for every view. Beside the agent stand
random walks and the frontier expert, who knows the plan, in episodes of that length.
Runs that are finished are not made again.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from explore_speed import make_settings
from main_job import run

from toponav.methods import make_world
from toponav.plotting import draw_sweep, save_figure
from toponav.reports import scripted_rows

#: Rooms of each maze, rows by columns, and episodes of each policy.
SIZES, EPISODES = ("5x6", "7x8", "10x10", "15x15", "20x20"), 8
#: Decisions of an episode for each open cell.
PER_CELL = 1_800 / 63


def measure(size: str, seed: int, work: Path, overrides: list[str]) -> dict[str, Any]:
    """The row of one maze."""
    rows, columns = map(int, size.split("x"))
    maze = ["maze=random", f"maze.rows={rows}", f"maze.cols={columns}", "maze.seed=3"]
    settings = make_settings("laptop", maze)
    layout = make_world(settings).layout
    assert layout is not None
    cells = int(torch.as_tensor(layout.open_mask).sum())
    length = round(PER_CELL * cells)
    words = [*maze[1:], f"maze.episode_length={length}", "reward.capacity=null"]
    words += [f"evaluate.episodes={EPISODES}", f"evaluate.random_episodes={EPISODES}"]
    place = work / size
    place.mkdir(parents=True, exist_ok=True)
    found = run("random", seed, place, [*words, *overrides])

    settings = make_settings("laptop", [*maze, *words[3:]])
    kept = replace(settings.evaluate, random_folder=f"{place}/random-{seed}-random")
    settings = replace(settings, evaluate=kept)
    expert = pd.DataFrame(scripted_rows(settings, make_world(settings), ["frontier"]))
    phases = [one["seconds"] for one in found["phases"].values()]
    return {
        "rooms": size,
        "area": (2 * rows + 1) * (2 * columns + 1),
        "cells": cells,
        "seed": seed,
        "episode_length": length,
        "minutes": round(found["minutes"], 1),
        **{
            f"{name}_coverage": round(100 * share, 1)
            for name, share in found["coverage"].items()
        },
        "frontier_coverage": round(100 * expert["coverage"].mean(), 1),
        "frontier_to_100": round(expert["decisions_to_100"].mean()),
        "decisions_per_second": round(found["exploring_decisions_per_second"]),
        **{f"map_{name}": round(value, 4) for name, value in found["map"].items()},
        **dict(zip(("pretrain_s", "explore_s", "finish_s"), phases, strict=True)),
    }


def panels(table: pd.DataFrame) -> pd.DataFrame:
    """What the figure shows: rows of panel, line, place and value."""
    table = table.assign(ms=1e3 / table["decisions_per_second"])
    shown = {
        "coverage of an episode (%)": {
            name: f"{name}_coverage"
            for name in ("best", "last", "random", "sticky", "frontier")
        },
        "waypoints of the map": {"waypoints": "map_waypoints"},
        "milliseconds of a decision, learning included": {"exploring": "ms"},
    }
    rows = [
        (panel, line, str(cells), value)
        for panel, lines in shown.items()
        for line, column in lines.items()
        for cells, value in zip(table["cells"], table[column], strict=True)
    ]
    return pd.DataFrame(rows, columns=["panel", "line", "at", "value"])


def main() -> None:
    """Make the runs, write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=list(SIZES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--work", type=Path, default=Path("runs/scaling"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    options = parser.parse_args()
    rows = []
    for seed in options.seeds:
        for size in options.sizes:
            given = options.work.resolve(), options.overrides
            rows.append(measure(size, seed, *given))
            print(rows[-1], flush=True)
    table = pd.DataFrame(rows)
    if options.out:
        table.to_csv(options.out, index=False, lineterminator="\n")
    if options.figure:
        figure = draw_sweep(panels(table), x="open cells", label="", same_y=False)
        save_figure(figure, options.figure)


if __name__ == "__main__":
    main()
