"""From the run folders of a sweep to a table of their maps."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from toponav.metrics import Scores, drop_unknown
from toponav.reports.sweep_report import read_all
from toponav.runs import (
    Run,
    group_runs,
    read_exploration,
    read_table,
    swept_settings,
)

#: The rows of the table, each from columns of ``map.csv``.
_MEASURES: dict[str, Callable[[pd.Series], float]] = {
    "waypoints in a cell": lambda row: row["waypoints"] / row["cells"],
    "cells with waypoints (%)": lambda row: 100 * row["coverage"],
    "first tenth of the views: waypoints (%)": (
        lambda row: 100 * row["first_waypoint_share"]
    ),
    "last tenth of the views: waypoints (%)": (
        lambda row: 100 * row["last_waypoint_share"]
    ),
    "false edges (%)": lambda row: 100 * row["false_edges"],
    "missing edges (%)": lambda row: 100 * row["missing_edges"],
    "parts without false edges": lambda row: row["true_components"],
    "planned path, of the shortest (%)": lambda row: 100 * row["stretch"],
    "planned paths over a false edge (%)": lambda row: 100 * row["false_paths"],
    "decisions to cover": lambda row: row["decisions_to_cover"],
}
_COLUMNS = (
    *("waypoints", "cells", "coverage", "first_waypoint_share", "last_waypoint_share"),
    *("false_edges", "missing_edges", "true_components", "stretch", "false_paths"),
    "decisions_to_cover",
)


def report_maps(runs: Sequence[Run]) -> tuple[list[Scores], list[str]]:
    """What the last map of each exploration is worth, a score ``[R]`` a measure.

    Values of the runs of a group that differ in their seeds alone. What some of them
    lack is left out, since the others would flatter: a map that never covered its maze
    has no decisions to cover. Beside them a sentence on this, and on every run that is
    not over, has no map, or none with ground truth.
    """
    results, left_out = read_all(runs, _last_map)
    names = swept_settings(runs)
    scores = []
    for settings, members in group_runs(results, names):
        for measure, of in _MEASURES.items():
            values = np.array([of(results[run]) for run in members], np.float64)
            scores.append(Scores(settings, "last map", measure, values))
    return drop_unknown(scores, left_out), left_out


def _last_map(folder: Path) -> pd.Series:
    """What judges the last map of an exploration that is over."""
    # While it explores, its last map has grown from a part of its views.
    read_exploration(folder)
    return read_table(folder / "map.csv", _COLUMNS).iloc[-1]
