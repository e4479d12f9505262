"""`report_navigation`: from the runs of a sweep of walks to goals to a table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from toponav.builders.run_folders import (
    BrokenRunError,
    Columns,
    Run,
    group_runs,
    read_columns,
    swept_settings,
)
from toponav.builders.sweep_report import SweepReport, label_of, read_all
from toponav.evaluation import Scores, draw_accuracies

#: What is told of each episode.
_COLUMNS = ("policy", "goals", "first_goal", "spl")
# Groups of settings that say what is shown, not what the agent or the maze is.
_NOT_OF_THE_AGENT = ("evaluate", "video")


def read_navigation(folder: Path) -> dict[str, Columns]:
    """By policy, the episodes of a finished run of ``recipes/navigate.py``.

    Args:
        folder: of the run.

    Raises:
        BrokenRunError: if it has not finished, or a column is missing.
    """
    table = read_columns(folder / "episodes.csv")
    if missing := [column for column in _COLUMNS if column not in table]:
        raise BrokenRunError(f"has no column '{missing[0]}' in its episodes.csv")
    return {
        str(policy): {
            name: column[table["policy"] == policy]
            for name, column in table.items()
            if name != "policy"
        }
        for policy in dict.fromkeys(table["policy"])
    }


def report_navigation(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Goals reached in an episode, by setting and policy.

    Reference:
        The paper, Tables 8 and 9.

    Args:
        runs: of ``recipes/navigate.py``.
        title: of the figure.
    """
    results, left_out = read_all(runs, read_navigation)
    names = [
        name
        for name in swept_settings(runs)
        if name.split(".")[0] not in _NOT_OF_THE_AGENT
    ]
    scores: list[Scores] = []
    for settings, members in group_runs(results, names):
        for policy in dict.fromkeys(name for run in members for name in results[run]):
            tables = [results[run][policy] for run in members if policy in results[run]]
            scores.append(_goals(settings, policy, tables))
    if not scores:
        return SweepReport("policy", "episodes", left_out=left_out)
    return SweepReport(
        "policy", "episodes", scores, _draw(scores, names, title), left_out
    )


def _draw(scores: Sequence[Scores], names: Sequence[str], title: str) -> Figure:
    """Over the setting with the most values; the others make panels."""
    choices = {name: {one.settings[name] for one in scores} for name in names}
    x = max(names, key=lambda name: len(choices[name]), default="")
    panels: dict[str, dict[str, list[tuple[str, list[float]]]]] = {}
    for one in scores:
        rest = {name: value for name, value in one.settings.items() if name != x}
        points = panels.setdefault(label_of(rest), {}).setdefault(one.subject, [])
        means = np.atleast_2d(one.values).mean(1).tolist()
        points.append((one.settings.get(x, "all runs"), means))
    return draw_accuracies(panels, x=x, label="goals in an episode", title=title)


def _goals(settings: dict[str, str], policy: str, tables: list[Columns]) -> Scores:
    """Goals ``[R, E]``, E the number of episodes that all runs have."""
    least = min(len(table["goals"]) for table in tables)
    first = np.concatenate([table["first_goal"] for table in tables])
    spl = np.concatenate([table["spl"] for table in tables])
    return Scores(
        settings,
        policy,
        "goals",
        np.stack([table["goals"][:least] for table in tables]),
        {
            "reached the goal (%)": 100 * float((first >= 0).mean()),
            "SPL (%)": 100 * float(spl.mean()),
        },
    )
