"""From the run folders of a sweep to its tables and figures.

A report is made of runs of one recipe; ``title`` stands over its figure.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from toponav.metrics import (
    AtMost,
    Floats,
    Scores,
    decisions_to_reach,
    drop_unknown,
)
from toponav.plotting import draw_learning_curves, draw_sweep
from toponav.reports.training_curves import WINDOW, median_until, training_curve
from toponav.runs import (
    BrokenRunError,
    Exploration,
    Run,
    group_runs,
    read_exploration,
    read_navigation,
    read_pretraining,
    swept_settings,
)

Result = TypeVar("Result")

# A run is judged by the first of these that it has.
_LEARNED = ("best", "last")
# Policies that do not learn, and what the figure calls them.
_SCRIPTED = {"random": "uniform random", "sticky": "sticky random"}
_PAPER_PAIRS = "at k = 4, M = 5 (%)"
# Groups of settings that say what is shown, not what a navigator or its maze is.
_SHOWN = ("evaluate", "video")


@dataclass(frozen=True)
class SweepReport:
    """What the runs of one recipe came to; no scores and no figure if none finished."""

    subject: str  # heading of the table's subjects: what a row is about
    unit: str  # heading of the number of values
    scores: list[Scores]  # in the order of the rows
    figure: Figure | None
    left_out: list[str]  # a sentence for every run that is not in it


def report_pretraining(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Accuracies of the TC- and the L-network, by setting and maze."""
    results, left_out = read_all(runs, read_pretraining)
    names = swept_settings(runs)
    scores: list[Scores] = []
    for settings, members in group_runs(results, names):
        table = 100 * pd.concat([results[run] for run in members])
        for maze, percent in table.groupby(level=0, sort=False):
            more = _other_shares(percent.dropna(axis=1, how="all"))
            tc, locomotion = percent[["accuracy", "locomotion_accuracy"]].to_numpy().T
            of, draws = str(maze), draws_of(members)
            tc, locomotion = tc[:, None], locomotion[:, None]
            scores.append(Scores(settings, of, "TC accuracy (%)", tc, more, draws))
            scores.append(Scores(settings, of, "L accuracy (%)", locomotion, {}, draws))
    scores = drop_unknown(scores, left_out)
    label = "accuracy on held-out episodes (%)"
    figure = draw_scores(scores, names, line="measure", label=label, title=title)
    return SweepReport("measured in", "values", scores, figure, left_out)


def _other_shares(percent: pd.DataFrame) -> dict[str, float]:
    """Means over the runs, NaN where one of them lacks the value."""
    labels = {"pose_bound": "true poses (%)", "tc_accuracy_k4_m5": _PAPER_PAIRS}
    for name in percent.filter(like="waypoint_share_"):
        labels[name] = f"waypoints at {name.removeprefix('waypoint_share_')} (%)"
    known = [name for name in labels if name in percent]
    return dict(percent[known].mean(skipna=False).rename(labels))


def draw_scores(
    scores: Sequence[Scores],
    names: Sequence[str],
    *,
    line: Literal["measure", "subject"],
    label: str,
    title: str,
) -> Figure | None:
    """Draw a dot a run over the setting with the most values; the others make panels.

    ``line`` is what a line is of. Where it is a measure, the subjects are panels too,
    unless the horizontal axis shows them already. Without scores there is no figure.
    """
    if not scores:
        return None
    choices = {name: {one.settings[name] for one in scores} for name in names}
    x = max(names, key=lambda name: len(choices[name]), default="")
    subjects = {(one.settings.get(x), one.subject) for one in scores}
    # Where each run is measured in the one maze it was trained in, x says it.
    says_subject = x == "maze" and len(subjects) == len(choices[x])
    rows = []
    for one in scores:
        panel = {} if line == "subject" or says_subject else {"in": one.subject}
        panel |= {name: value for name, value in one.settings.items() if name != x}
        group = getattr(one, line).removesuffix(" (%)")
        key = (label_of(panel), group, one.settings.get(x, "all runs"))
        rows += [(*key, value) for value in np.atleast_2d(one.values).mean(axis=1)]
    values = pd.DataFrame(rows, columns=["panel", "line", "at", "value"])
    return draw_sweep(values, x=x, label=label, title=title)


def report_exploration(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Coverage of the learned and the scripted policies, and learning curves.

    That of the scripted policies depends on maze and engine alone: their episodes of
    all runs there are put together; runs whose episodes are the same count once. If no
    run knows its coverage, it is the intrinsic return, which depends on all settings.
    """
    results, left_out = read_all(runs, read_exploration)
    _drop_without_coverage(results, left_out)
    names = swept_settings(runs)
    _drop_short_evaluations(results, names, left_out)
    if not results:
        return SweepReport("policy", "episodes", [], None, left_out)
    scores: list[Scores] = []
    panels: dict[str, dict[str, list[tuple[Floats, Floats]]]] = {}
    levels: dict[str, dict[str, float]] = {}
    blind = next(iter(results.values())).measure != "coverage"
    label = "intrinsic return" if blind else "coverage (%)"
    where = ("maze", "engine")
    of_maze = [name for name in names if blind or name.split(".")[0] in where]
    others = [name for name in names if name not in of_maze]
    for maze, in_maze in group_runs(results, of_maze):
        panel = panels.setdefault(label_of(maze), {})
        for settings, members in group_runs(in_maze, others):
            explorations = [results[run] for run in members]
            learned = _learned_scores({**maze, **settings}, explorations, label)
            scores += [replace(one, draws=draws_of(members)) for one in learned]
            panel[label_of(settings)] = [training_curve(one) for one in explorations]
        scripted = _scripted_scores(maze, [results[run] for run in in_maze], label)
        scores += scripted
        levels[label_of(maze)] = {
            _SCRIPTED[one.subject]: float(one.values.mean()) for one in scripted
        }
    name, *percent = label.split(" (")
    label = " (".join([f"{name}, mean of the last {WINDOW} episodes", *percent])
    figure = draw_learning_curves(
        panels, levels, label=label, title=title, percent=not blind
    )
    return SweepReport("policy", "episodes", scores, figure, left_out)


def _learned_scores(
    settings: Mapping[str, str], explorations: list[Exploration], label: str
) -> list[Scores]:
    """Scores ``[R, E]`` of the learned policies that all runs of a group have."""
    scores: list[Scores] = []
    for policy in _LEARNED:
        tables = [_episodes_of(policy, one) for one in explorations]
        if all(map(len, tables)):
            values = np.stack([table["score"] for table in tables])
            more: dict[str, float | AtMost] = {**_decisions_to_90(pd.concat(tables))}
            if more and not scores:
                # Without the pre-training, unlike "training to" in an experiment.
                more["exploring to 90 %"] = median_until(explorations, 90)
            scores.append(Scores(settings, policy, label, values, more))
    return scores


def _scripted_scores(
    maze: Mapping[str, str], explorations: list[Exploration], label: str
) -> list[Scores]:
    """Scores ``[N]`` of each scripted policy in all runs, equal tables once."""
    scores = []
    for policy in _SCRIPTED:
        tables = [_episodes_of(policy, one) for one in explorations]
        # The same seed in the same maze gives the same episodes in every run.
        table = pd.concat({one.to_numpy().tobytes(): one for one in tables}.values())
        if len(table):
            values, more = table["score"].to_numpy(), _decisions_to_90(table)
            scores.append(Scores(maze, policy, label, values, more))
    return scores


def _episodes_of(policy: str, one: Exploration) -> pd.DataFrame:
    rows = one.evaluation["policy"] == policy
    return one.evaluation[rows].filter(["score", "decisions_to_90"])


def _decisions_to_90(table: pd.DataFrame) -> dict[str, float]:
    if "decisions_to_90" not in table:
        return {}
    median, share = decisions_to_reach(table["decisions_to_90"])
    return {"decisions to 90 %": median, "share to 90 % (%)": 100 * share}


def _drop_without_coverage(
    results: dict[Run, Exploration], left_out: list[str]
) -> None:
    """Leave out the runs without coverage if others have it."""
    without = [run for run, one in results.items() if one.measure != "coverage"]
    for run in without if len(without) < len(results) else ():
        del results[run]
        sentence = "it has no coverage: its world has no ground truth"
        left_out.append(f"{run.folder} is left out: {sentence}")


def _drop_short_evaluations(
    results: dict[Run, Exploration], names: list[str], left_out: list[str]
) -> None:
    """Leave out the runs of a group with fewer episodes of a policy than its others."""
    for (_, members), policy in product(group_runs(list(results), names), _LEARNED):
        left = [run for run in members if run in results]
        counts = {run: len(_episodes_of(policy, results[run])) for run in left}
        most = max(counts.values(), default=0)
        for run, count in counts.items():
            if 0 < count < most:
                del results[run]
                left_out.append(
                    f"{run.folder} is left out: it has {count} evaluation episodes, "
                    f"other runs with its settings {most}"
                )


def report_navigation(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Goals ``[R, E]`` reached in an episode, by setting and policy.

    E is the number of episodes that all runs of a group have; others do not count.

    Reference:
        The paper, Tables 8 and 9.
    """
    results, left_out = read_all(runs, read_navigation)
    swept = swept_settings(runs)
    names = [name for name in swept if name.split(".")[0] not in _SHOWN]
    scores = []
    for settings, members in group_runs(results, names):
        episodes = pd.concat({run.folder: results[run] for run in members})
        for policy, every in episodes.groupby("policy", sort=False):
            of_runs = every.groupby(level=0, sort=False)
            table = of_runs.head(of_runs.size().min())
            values = table["goals"].to_numpy().reshape(of_runs.ngroups, -1)
            more = {
                "reached the goal (%)": 100 * float((table["first_goal"] >= 0).mean()),
                "SPL (%)": 100 * float(table["spl"].mean()),
            }
            scores.append(Scores(settings, str(policy), "goals", values, more))
    label = "goals in an episode"
    figure = draw_scores(scores, names, line="subject", label=label, title=title)
    return SweepReport("policy", "episodes", scores, figure, left_out)


def label_of(settings: Mapping[str, object]) -> str:
    """Settings as a heading or a name in a legend."""
    return ", ".join(
        str(value) if name in ("maze", "in") else f"{name} {value}"
        for name, value in settings.items()
    )


def draws_of(runs: Sequence[Run]) -> list[str]:
    """What was drawn for each of the runs, none if for one of them nothing was."""
    draws = [label_of(run.drawn) for run in runs]
    return draws if all(draws) else []


def read_all(
    runs: Iterable[Run], read: Callable[[Path], Result]
) -> tuple[dict[Run, Result], list[str]]:
    """The results of the finished runs, and a sentence on each of the others."""
    results, left_out = {}, []
    for run in runs:
        try:
            results[run] = read(run.folder)
        except BrokenRunError as error:
            left_out.append(f"{run.folder} is left out: it {error}")
    return results, left_out
