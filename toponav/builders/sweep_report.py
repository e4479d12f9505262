"""From the run folders of a sweep to its tables and figures.

- `report_pretraining`: accuracies of both networks by setting and maze.
- `report_exploration`: coverage by setting and policy, learning curves.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from toponav.builders.run_folders import (
    BrokenRunError,
    Columns,
    Exploration,
    Run,
    group_runs,
    read_exploration,
    read_pretraining,
    swept_settings,
)
from toponav.evaluation import (
    Curve,
    Scores,
    decisions_to_reach,
    draw_accuracies,
    draw_learning_curves,
    running_mean,
)

Result = TypeVar("Result")

#: Episodes over which the coverage of a training is averaged.
WINDOW = 16
# Policies that do not learn: their levels hold for all runs in a maze.
_SCRIPTED = ("random", "sticky")
_LEARNED = ("best", "last")
_GOOD = 0.9
_MEASURED_IN = "measured in"


@dataclass(frozen=True)
class SweepReport:
    """What the runs of one recipe came to.

    Args:
        subject: what each row of the table is about, beside the settings.
        unit: what its values are of.
        scores: in the order of the rows; none if no run has finished.
        figure: of all runs, none if none has finished.
        left_out: a sentence for every run that is not in it.
    """

    subject: str
    unit: str
    scores: list[Scores] = field(default_factory=list)
    figure: Figure | None = None
    left_out: list[str] = field(default_factory=list)


def report_pretraining(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Accuracies of the TC- and the L-network, by setting and maze.

    Args:
        runs: of ``recipes/pretrain.py``.
        title: of the figure.
    """
    results, left_out = read_all(runs, read_pretraining)
    if not results:
        return SweepReport(_MEASURED_IN, "values", left_out=left_out)
    names = swept_settings(runs)
    groups = group_runs(results, names)
    scores = []
    for settings, members in groups:
        for maze in _union(results[run] for run in members):
            figures = [results[run][maze] for run in members if maze in results[run]]
            scores += _network_scores(settings, maze, figures)
    return SweepReport(
        _MEASURED_IN, "values", scores, _draw_networks(scores, names, title), left_out
    )


def _network_scores(
    settings: dict[str, str], maze: str, figures: list[dict[str, float]]
) -> list[Scores]:
    """A group's accuracies in one maze, in percent."""

    def values(name: str) -> NDArray[np.float64]:
        found = [one.get(name, math.nan) for one in figures]
        return 100 * np.array(found)[:, None]

    more = {"true poses (%)": values("pose_bound").mean()}
    if any("tc_accuracy_k4_m5" in one for one in figures):
        more["at k = 4, M = 5 (%)"] = values("tc_accuracy_k4_m5").mean()
    for name in _union(figures):
        if name.startswith("waypoint_share_"):
            at = name.removeprefix("waypoint_share_")
            more[f"waypoints at {at} (%)"] = values(name).mean()
    return [
        Scores(settings, maze, "TC accuracy (%)", values("accuracy"), more),
        Scores(settings, maze, "L accuracy (%)", values("locomotion_accuracy")),
    ]


def _draw_networks(scores: list[Scores], names: list[str], title: str) -> Figure:
    """Over the setting with the most values; the others and the maze make panels."""
    choices = {name: {one.settings[name] for one in scores} for name in names}
    x = max(names, key=lambda name: len(choices[name]), default="")
    panels: dict[str, dict[str, list[tuple[str, list[float]]]]] = {}
    mazes = {(one.settings.get(x), one.subject) for one in scores}
    # Where each run is measured in the one maze it was trained in, x says it.
    says_maze = x == "maze" and len(mazes) == len(choices[x])
    for one in scores:
        rest = {name: value for name, value in one.settings.items() if name != x}
        heading = label_of(rest if says_maze else {"in": one.subject, **rest})
        lines = panels.setdefault(heading, {})
        points = lines.setdefault(one.measure.removesuffix(" (%)"), [])
        points.append((one.settings.get(x, "all runs"), one.values[:, 0].tolist()))
    return draw_accuracies(
        panels, x=x, label="accuracy on held-out episodes (%)", title=title
    )


def report_exploration(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Coverage of the learned and the scripted policies, and learning curves.

    The scripted policies depend on the maze alone: their episodes of all runs in it
    are put together; runs whose walks are the same count once.

    Args:
        runs: of ``recipes/explore.py``.
        title: of the figure.
    """
    results, left_out = read_all(runs, read_exploration)
    names = swept_settings(runs)
    _drop_short_evaluations(results, names, left_out)
    if not results:
        return SweepReport("policy", "episodes", left_out=left_out)
    scores: list[Scores] = []
    panels: dict[str, list[Curve]] = {}
    levels: dict[str, dict[str, float]] = {}
    of_maze = [name for name in names if name.split(".")[0] == "maze"]
    others = [name for name in names if name not in of_maze]
    for maze, in_maze in group_runs(results, of_maze):
        heading = label_of(maze)
        for settings, members in group_runs(in_maze, others):
            explorations = [results[run] for run in members]
            for policy in _LEARNED:
                found = [one.evaluation.get(policy) for one in explorations]
                tables = [one for one in found if one is not None]
                if len(tables) == len(members):
                    more = _training(explorations) if policy == "best" else {}
                    scores.append(_coverage({**maze, **settings}, policy, tables, more))
            curve = Curve(
                label_of(settings), [_training_curve(one) for one in explorations]
            )
            panels.setdefault(heading, []).append(curve)
        for policy in _SCRIPTED:
            if table := _pooled(policy, [results[run] for run in in_maze]):
                score = _coverage(maze, policy, [table], {})
                scores.append(score)
                mean = float(np.mean(score.values))
                levels.setdefault(heading, {})[_walk(policy)] = mean
    figure = draw_learning_curves(
        panels,
        levels,
        label=f"coverage, mean of the last {WINDOW} episodes (%)",
        title=title,
    )
    return SweepReport("policy", "episodes", scores, figure, left_out)


def _walk(policy: str) -> str:
    return {"random": "uniform random"}.get(policy, f"{policy} random")


def _coverage(
    settings: Mapping[str, str],
    policy: str,
    tables: list[Columns],
    more: Mapping[str, float],
) -> Scores:
    """Coverage in percent: ``[R, E]`` of learned policies, ``[N]`` of scripted ones."""
    values = 100 * np.stack([table["coverage"] for table in tables])
    median, share = decisions_to_reach(
        np.concatenate([table["decisions_to_90"] for table in tables])
    )
    reached = {"decisions to 90 %": median, "share to 90 % (%)": 100 * share}
    return Scores(
        settings,
        policy,
        "coverage (%)",
        values[0] if policy in _SCRIPTED else values,
        {**reached, **more},
    )


def _training_curve(
    one: Exploration,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    coverage = running_mean(100 * one.episodes["coverage"], WINDOW)
    return one.episodes["decisions"], coverage


def _training(explorations: list[Exploration]) -> dict[str, float]:
    """Decisions of the training until the mean of its episodes passed 90 %."""
    taken = []
    for one in explorations:
        decisions, coverage = _training_curve(one)
        good = np.flatnonzero(coverage[WINDOW - 1 :] >= 100 * _GOOD) + WINDOW - 1
        taken.append(float(decisions[good[0]]) if len(good) else -1.0)
    return {"training to 90 %": decisions_to_reach(taken)[0]}


def _pooled(policy: str, explorations: list[Exploration]) -> Columns | None:
    """Episodes of a scripted policy in all runs, those of equal walks once."""
    tables = [
        one.evaluation[policy] for one in explorations if policy in one.evaluation
    ]
    # A walk in the same maze with the same seed gives the same table, run for run.
    names = ("coverage", "decisions_to_90")
    different = {
        tuple(table[name].tobytes() for name in names): table for table in tables
    }
    if not different:
        return None
    return {
        name: np.concatenate([table[name] for table in different.values()])
        for name in names
    }


def _drop_short_evaluations(
    results: dict[Run, Exploration], names: list[str], left_out: list[str]
) -> None:
    """Leave out the runs of a group that have fewer episodes than its others."""
    for _, members in group_runs(list(results), names):
        counts = {
            run: len(results[run].evaluation["best"]["coverage"]) for run in members
        }
        most = max(counts.values())
        for run, count in counts.items():
            if count < most:
                del results[run]
                left_out.append(
                    f"{run.folder} is left out: it has {count} evaluation episodes, "
                    f"other runs with its settings {most}"
                )


def label_of(settings: Mapping[str, str]) -> str:
    """Settings as a heading or a name in a legend.

    Examples:
        >>> label_of({"maze": "maze3", "reward.alpha": "0.2"})
        'maze3, reward.alpha 0.2'
    """
    return ", ".join(
        value if name in ("maze", "in") else f"{name} {value}"
        for name, value in settings.items()
    )


def read_all(
    runs: Iterable[Run], read: Callable[[Path], Result]
) -> tuple[dict[Run, Result], list[str]]:
    """What the finished runs wrote, and a sentence on each of the others."""
    results, left_out = {}, []
    for run in runs:
        try:
            results[run] = read(run.folder)
        except BrokenRunError as error:
            left_out.append(f"{run.folder} is left out: it {error}")
    return results, left_out


def _union(mappings: Iterable[Mapping[str, object]]) -> list[str]:
    return list(dict.fromkeys(name for one in mappings for name in one))
