"""The learning curves of the sanity tasks: one table for each benchmark, one figure.

    PYTHONPATH=. python benchmarks/sanity_curves.py --out results/sanity.png

`sanity_trpo`, `sanity_rivals` and `sanity_rooms` write the tables, a run at a time: one
that was cut off is started again, and those that are there are not made twice. The
figure has a panel a task, with the mean and the range of each method's seeds.
"""

import argparse
import csv
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from toponav.plotting import draw_learning_curves, save_figure

#: What a run is known by.
RUN = ("task", "seed", "method")
#: Of each panel: its title, table, task, column, factor and unit.
PANELS = (
    ("CartPole: TRPO", "trpo", "cartpole", "mean_return", 1, "return"),
    ("Pendulum: TRPO", "trpo", "pendulum", "mean_return", 1, "return"),
    ("CartPole that pays nothing", "trpo", "unpaid", "mean_return", 1, "decisions"),
    ("MountainCar: VIME", "rivals", "mountain_car", "goal_share", 100, "goals (%)"),
    ("Maze of points: EX2", "rivals", "point_maze", "places_so_far", 100, "cells (%)"),
    ("Four rooms: ICM, RND", "rooms", "rooms", "far_share", 100, "in room 4 (%)"),
)


@dataclass
class CurveTable:
    """A table of runs, which are added whole.

    Args:
        path: of the CSV.
        measures: names of the columns between ``decisions`` and the times.
    """

    path: Path
    measures: tuple[str, ...]

    @property
    def head(self) -> list[str]:
        """Names of all columns; ``load`` is the machine's at the end of the run."""
        return [*RUN, "decisions", *self.measures, "wall_s", "cpu_s", "load"]

    def has(self, *run: object) -> bool:
        """Whether there are rows of this task, seed and method."""
        if not self.path.exists():
            return False
        with self.path.open(newline="") as file:
            found = {tuple(row[name] for name in RUN) for row in csv.DictReader(file)}
        return tuple(map(str, run)) in found

    def add(self, run: tuple[object, ...], rows: Iterable[tuple[object, ...]]) -> None:
        """Wait for all rows of a run, decisions and measures, then append them."""
        wall, cpu = time.perf_counter(), time.process_time()
        lines = []
        for row in rows:
            spent = time.perf_counter() - wall, time.process_time() - cpu
            load = os.getloadavg()[0]
            lines.append([*run, *row, *(f"{one:.1f}" for one in (*spent, load))])
        is_new = not self.path.exists()
        with self.path.open("a", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerows([self.head, *lines] if is_new else lines)
        print(*lines[-1], flush=True)


def main() -> None:
    """Draw the figure from the tables beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    panels, units = {}, []
    for title, name, task, column, factor, unit in PANELS:
        path = out.with_name(f"sanity_{name}.csv")
        table = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=RUN)
        runs = table[table["task"] == task]
        if len(runs) == 0:
            continue
        panels[title] = {
            str(method): [
                (run["decisions"].to_numpy(float), factor * run[column].to_numpy(float))
                for _, run in group.groupby("seed")
            ]
            for method, group in runs.groupby("method", sort=False)
        }
        units.append(unit)
    figure = draw_learning_curves(panels, {}, label="")
    for axes, unit in zip(figure.axes, units, strict=True):
        axes.set_ylabel(unit)
        if "%" not in unit:
            axes.relim()
            axes.set_ylim(auto=True)
            axes.autoscale(axis="y")
    save_figure(figure, out)


if __name__ == "__main__":
    main()
