"""What the rules of pairs of views that confirm each other make of the same views.

    python benchmarks/confirm_rules.py runs/explore/select-... runs/explore/random-... \
        --out results/confirm_rules.csv

Where pairs of views that look like one place give less than ``PoseRules.least_known``
of the views a direction, those alone count that others confirm (``ConfirmRules``), and
if even then fewer have one, a map stays as it grew. Maps of explorations are made again
from their checkpoints, where they are as they grew, by the default rules, by other
draws (``seed``: what chance alone changes) and with one rule at a time lower and
higher, and the ground truth judges them. ``--directions`` asks for the directions
alone, which take seconds.
"""

import argparse
import csv
import shutil
import tempfile
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pose_maps import read_settings, restore, rounded
from torch import Tensor
from tqdm import tqdm

from toponav.graph import PoseRules, consolidate
from toponav.graph.poses import estimate_poses
from toponav.ground_truth import wrap_degrees
from toponav.training import MapGrowth

#: Values of each rule. Those of the seed are added to the run's own; that of a map as
#: it grew is a share that no map has.
LEVERS: dict[str, tuple[float, ...]] = {
    "as it grew": (2,),
    "default": (0,),
    "seed": (1, 2),
    "least_known": (0.0, 0.6, 0.9),
    "confirm.window": (10, 40),
    "confirm.least": (1.5, 6.0),
    "confirm.turned": (15.0, 60.0),
    "confirm.apart": (1.0, 4.0),
    "confirm.share": (0.15, 0.6),
    "confirm.times": (1, 4),
    "confirm.passes": (1, 4),
}
#: Share of the views with a direction by all pairs; whether confirmed pairs alone
#: counted; share by those that count, and how many of these directions are wrong;
#: whether the map was made by poses.
FOUND = ("all_pairs", "confirmed", "placed", "turned", "by_poses")
QUALITY = (
    *("waypoints", "coverage", "false_edges", "missing_edges", "false_paths"),
    *("components", "true_components", "stretch"),
)
COLUMNS = ["maze", "seed", "rule", "value", *FOUND, *QUALITY]
#: Degrees by which a direction must differ from most others to be wrong.
WRONG = 30.0


def change(rules: PoseRules, name: str, value: float) -> PoseRules:
    """Rules of which one has another value."""
    room, _, of_confirm = name.rpartition(".")
    if room:
        return replace(rules, confirm=replace(rules.confirm, **{of_confirm: value}))
    if name == "seed":
        return replace(rules, seed=rules.seed + int(value))
    return rules if name == "default" else replace(rules, least_known=value)


def find_headings(growth: MapGrowth, rules: PoseRules) -> Tensor:
    """Degrees of all views, NaN without a direction; they come before positions."""
    walks = [walk for walk in growth.map.walks.all() if len(walk.actions)]
    known = growth.map.waypoints.compare, growth.map.waypoints.entries_of
    given = walks, growth.effects, *known, replace(rules, rounds=0)
    return estimate_poses(*given).heading


def turned(growth: MapGrowth, headings: Tensor) -> float:
    """Share of the waypoints with a direction whose one is not that of most."""
    off, origins = [], growth.map.waypoints.origins
    for walk in growth.map.walks.all():
        own, headings = headings.tensor_split([len(walk.actions)])
        at = origins[:, 1] - walk.number
        here = (origins[:, 0] == walk.env) & (at >= 0) & (at < len(own))
        off.append(own[at[here]] - growth.truth.poses.values[here, 2])
    known = torch.cat(off)
    known = known[known.isfinite()]
    apart = wrap_degrees(known.unsqueeze(1) - known).abs() > WRONG
    return float(apart.float().mean(1).min()) if len(known) else float("nan")


def judge(growth: MapGrowth, rules: PoseRules, *, by_poses: bool) -> dict[str, Any]:
    """Make a map again by the rules, if it is to be, and judge it."""
    row: dict[str, Any] = {"by_poses": by_poses}
    if by_poses:
        config, given = growth.config, (growth.map, growth.effects, rules)
        within = {"within": config.poses_within, "above": config.poses_above}
        found = consolidate(*given, **within)
        row["by_poses"] = found.poses is not None
        growth.truth.poses.keep(found.kept)
    now = growth.snapshot()
    judged = growth.truth.measure(now, growth.truth.lengths(now))
    return row | {name: judged[name] for name in QUALITY}


@torch.no_grad()
def compare(growth: MapGrowth, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Rows of the map of one run."""
    saved, made = deepcopy(growth.state_dict()), dict[Any, dict[str, Any]]()
    usual = PoseRules(above=growth.map.rules.tc_threshold, seed=growth.seed)
    alone = find_headings(growth, replace(usual, least_known=0.0))
    share = float(alone.isfinite().float().mean())
    levers = [(name, value) for name in options.levers for value in LEVERS[name]]
    for name, value in tqdm(levers):
        growth.load_state_dict(deepcopy(saved))
        rules = change(usual, name, value)
        confirmed = share < rules.least_known
        headings = find_headings(growth, rules) if confirmed else alone
        placed = float(headings.isfinite().float().mean())
        row = {"rule": name, "value": value, "all_pairs": share, "placed": placed}
        row |= {"confirmed": confirmed, "turned": turned(growth, headings)}
        # Of the same pairs of views it is the same map.
        kept = placed >= rules.least_known
        key = kept and (rules.seed, confirmed and rules.confirm)
        if not options.directions and key not in made:
            made[key] = judge(growth, rules, by_poses=kept)
        yield row | made.get(key, {})


def main() -> None:
    """Make the maps, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--levers", nargs="+", default=list(LEVERS))
    parser.add_argument("--directions", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for run in options.runs:
        settings, left_out = read_settings(run), shutil.ignore_patterns("logs")
        size = f"{settings.maze.rows}x{settings.maze.cols}, {settings.maze.seed}"
        maze = size if settings.maze.name == "random" else settings.maze.name
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(shutil.copytree(run, Path(folder) / "run", ignore=left_out))
            growth, _ = restore(run, copy, None)
            for row in compare(growth, options):
                row |= {"maze": maze, "seed": settings.seed}
                rows.append([rounded(row.get(name, "")) for name in COLUMNS])
                tqdm.write(str(dict(zip(COLUMNS, rows[-1], strict=True))))
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
