"""`report_navigation`: from the runs of a sweep of navigation to a table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from toponav.metrics import Scores
from toponav.reports.sweep_report import SweepReport, draw_scores, read_all
from toponav.runs import Run, group_runs, read_table, swept_settings

# Groups of settings that say what is shown, not what the agent or the maze is.
_NOT_OF_THE_AGENT = ("evaluate", "video")


def report_navigation(runs: Sequence[Run], *, title: str = "") -> SweepReport:
    """Goals reached in an episode, by setting and policy.

    Reference:
        The paper, Tables 8 and 9.

    Args:
        runs: of ``recipes/navigate.py``.
        title: of the figure.
    """
    results, left_out = read_all(runs, _read_episodes)
    names = [
        name
        for name in swept_settings(runs)
        if name.split(".")[0] not in _NOT_OF_THE_AGENT
    ]
    scores = []
    for settings, members in group_runs(results, names):
        episodes = pd.concat({run.folder: results[run] for run in members})
        for policy, table in episodes.groupby("policy", sort=False):
            scores.append(_goals(settings, str(policy), table))
    figure = None
    if scores:
        figure = draw_scores(
            scores, names, label="goals in an episode", title=title, line_of=_policy_of
        )
    return SweepReport("policy", "episodes", scores, figure, left_out)


def _read_episodes(folder: Path) -> pd.DataFrame:
    return read_table(folder / "episodes.csv", ("policy", "goals", "first_goal", "spl"))


def _policy_of(score: Scores) -> str:
    return score.subject


def _goals(settings: dict[str, str], policy: str, table: pd.DataFrame) -> Scores:
    """Goals ``[R, E]``, E the number of episodes that all runs have."""
    goals = [run.to_numpy() for _, run in table["goals"].groupby(level=0, sort=False)]
    least = min(map(len, goals))
    more = {
        "reached the goal (%)": 100 * float((table["first_goal"] >= 0).mean()),
        "SPL (%)": 100 * float(table["spl"].mean()),
    }
    values = np.stack([run[:least] for run in goals])
    return Scores(settings, policy, "goals", values, more)
