"""The figure of an experiment, from the folders of its runs."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from toponav.metrics import Floats
from toponav.plotting import draw_learning_curves, draw_sweep
from toponav.reports.experiment_report import Group
from toponav.reports.training_curves import WINDOW, training_curve
from toponav.runs import read_exploration, read_pretraining


def experiment_curves(
    groups: Sequence[Group],
    scripted: Mapping[str, Sequence[Mapping[str, Any]]],
    *,
    title: str,
) -> Figure:
    """Learning curves: coverage over the decisions, those of pre-training included.

    Where nobody knows these the name says so.
    """
    panels: dict[str, dict[str, list[tuple[Floats, Floats]]]] = {}
    levels: dict[str, dict[str, float]] = {}
    for group in groups:
        panel = panels.setdefault(group.maze, {})
        curves = [
            training_curve(read_exploration(folder)) for folder in group.runs.values()
        ]
        name, before = group.row, group.before
        if math.isnan(before):
            name, before = f"{name}, without its pre-training", 0.0
        if curves:
            panel[name] = [(at + before, score) for at, score in curves]
        rows = pd.DataFrame(scripted.get(group.maze, ()))
        if len(rows):
            means = 100 * rows.groupby("policy", sort=False)["coverage"].mean()
            levels[group.maze] = {str(name): float(at) for name, at in means.items()}
    label = f"coverage (%), mean of the last {WINDOW} episodes"
    return draw_learning_curves(panels, levels, label=label, title=title)


def experiment_accuracies(groups: Sequence[Group], *, title: str) -> Figure:
    """Accuracies of both networks, a dot a run, over the rows."""
    rows = []
    lines = {"TC": "accuracy", "L": "locomotion_accuracy"}
    for group in groups:
        for folder in group.runs.values():
            means = 100 * read_pretraining(folder).mean(numeric_only=True)
            for line, name in lines.items():
                rows.append((group.maze, line, group.row, float(means[name])))
    values = pd.DataFrame(rows, columns=["panel", "line", "at", "value"])
    label = "accuracy on held-out episodes (%)"
    return draw_sweep(values, x="row", label=label, title=title)
