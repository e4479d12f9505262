r"""Exploration, map and navigation in mazes from 11x13 to 41x41, one row a maze.

    python benchmarks/scaling.py --out results/scaling.csv --figure results/scaling.png
    python benchmarks/scaling.py --sizes 5x6 8x8 --work runs/scaling
    python benchmarks/scaling.py --sizes 2x2 --navigate scale=smoke -- scale=smoke

Each run is a main job from nothing in a generated maze (``benchmarks/main_job.py``): R
x C rooms make a plan of 2 R + 1 by 2 C + 1 cells, border included, the area. Episodes
grow with the number of open cells, so that each cell has as many decisions as in the
smallest maze at 1,800; the memory of an episode has room for every view. Beside the
agent stand random walks and the frontier expert, who knows the plan, in episodes of
that length.

Then ``recipes/navigate.py`` plays a few episodes of 5,000 decisions over its map, with
the oracle and random walks beside the navigator: goals of an episode, and the share of
the episodes that reached one. Since ways grow with the maze, the oracle reaches fewer
goals in a larger one; its share compares. Where the views did not fit together by their
poses the map stayed as it grew, and ``navigator`` is ``topological``.

Runs that are finished are not made again, and the table is written after each maze;
rows that it has are kept. So the same command goes on where it was cut off, here or on
another machine.
"""

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from explore_speed import compose_settings
from main_job import ROOT, run

from toponav.builders import PLACES_FILE
from toponav.config import ExploreConfig
from toponav.methods import make_world
from toponav.plotting import draw_sweep, save_figure
from toponav.reports import scripted_rows

#: Rooms of each maze, rows by columns, and episodes of each policy.
SIZES, EPISODES, TOURS = ("5x6", "7x8", "10x10", "15x15", "20x20"), 8, 4
#: Decisions of an episode for each open cell.
PER_CELL = 1_800 / 63
#: Who explores, in the order of the figure, and who navigates.
EXPLORERS = ("best", "random", "sticky", "frontier")
NAVIGATORS = ("navigator", "oracle", "random")


def measure(
    size: str, seed: int, work: Path, overrides: list[str], tour: list[str]
) -> dict[str, Any]:
    """The row of one maze; ``tour`` are more settings of its navigation."""
    rows, columns = map(int, size.split("x"))
    maze = [f"maze.rows={rows}", f"maze.cols={columns}", "maze.seed=3"]
    cells = count_cells(["maze=random", *maze])
    length = round(PER_CELL * cells)
    words = [*maze, f"maze.episode_length={length}", "reward.capacity=null"]
    words += [f"evaluate.episodes={EPISODES}", f"evaluate.random_episodes={EPISODES}"]
    words += overrides
    place = work / size
    place.mkdir(parents=True, exist_ok=True)
    found = run("random", seed, place, words)
    expert = play_frontier(["maze=random", *words], place / f"random-{seed}-random")
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
        **navigate(place / f"random-{seed}", seed, tour),
    }


def count_cells(words: list[str]) -> int:
    """Open cells of a maze."""
    layout = make_world(compose_settings("explore", words)).layout
    assert layout is not None
    return int(torch.as_tensor(layout.open_mask).sum())


def play_frontier(words: list[str], kept: Path) -> pd.DataFrame:
    """Episodes of the expert that knows the plan, found in ``kept`` or played."""
    settings = compose_settings("explore", words)
    assert isinstance(settings, ExploreConfig)
    evaluate = replace(settings.evaluate, random_folder=str(kept))
    settings = replace(settings, evaluate=evaluate)
    return pd.DataFrame(scripted_rows(settings, make_world(settings), ["frontier"]))


def navigate(explored: Path, seed: int, overrides: list[str]) -> dict[str, Any]:
    """Goals over the map of an exploration, its navigator's beside the others'."""
    navigator = "poses" if (explored / PLACES_FILE).is_file() else "topological"
    folder = Path(f"{explored}-navigate")
    # The last file that the recipe writes.
    if not (folder / "path.png").is_file():
        words = [f"run={explored}", f"seed={seed}", f"evaluate.episodes={TOURS}"]
        words += [f"evaluate.policies=[{','.join(NAVIGATORS)}]", "video.decisions=0"]
        words += [*overrides, f"navigator={navigator}", f"hydra.run.dir={folder}"]
        command = [sys.executable, str(ROOT / "recipes" / "navigate.py"), *words]
        with Path(f"{folder}.log").open("w") as log:
            done = subprocess.run(
                command, stdout=log, stderr=subprocess.STDOUT, check=False
            )
        if done.returncode:
            raise SystemExit(f"{folder}.log: exit status {done.returncode}")
    played = pd.read_csv(folder / "episodes.csv").groupby("policy")["goals"]
    goals, reached = played.mean(), played.agg(lambda of: (of > 0).mean())
    row = {"navigator": navigator}
    row |= {f"{name}_goals": round(goals[name], 1) for name in NAVIGATORS}
    return row | {f"{name}_success": round(reached[name], 3) for name in NAVIGATORS}


def panels(table: pd.DataFrame) -> pd.DataFrame:
    """What the figure shows: rows of panel, line, place and value."""
    table = table.assign(ms=1e3 / table["decisions_per_second"])
    shown = {
        "coverage of an episode (%)": {name: f"{name}_coverage" for name in EXPLORERS},
        "waypoints of the map": {"waypoints": "map_waypoints"},
        "milliseconds of a decision, learning included": {"exploring": "ms"},
        "goals of an episode": {name: f"{name}_goals" for name in NAVIGATORS},
    }
    rows = [
        (panel, line, str(area), value)
        for panel, lines in shown.items()
        for line, column in lines.items()
        for area, value in zip(table["area"], table[column], strict=True)
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
    parser.add_argument(
        "--navigate", nargs="+", default=[], help="more settings of the navigation"
    )
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    options = parser.parse_args()
    out, rows = options.out, []
    if out and out.is_file():
        rows = pd.read_csv(out).to_dict("records")
    made = {(row["rooms"], row["seed"]) for row in rows}
    for seed in options.seeds:
        for size in options.sizes:
            if (size, seed) in made:
                continue
            given = options.work.resolve(), options.overrides, options.navigate
            rows.append(measure(size, seed, *given))
            print(rows[-1], flush=True)
            if out:
                table = pd.DataFrame(rows)
                table.to_csv(out, index=False, lineterminator="\n")
    if options.figure:
        look = {"x": "area (cells, walls included)", "label": "", "same_y": False}
        table = pd.DataFrame(rows).sort_values(["area", "seed"])
        save_figure(draw_sweep(panels(table), **look), options.figure)


if __name__ == "__main__":
    main()
