"""Navigate to goals over the map of an exploration, through blockages too.

    python recipes/navigate.py run=runs/explore/maze1-...
    python recipes/navigate.py -m run=... 'maze.blocked=[],[a],[b],[a,b]'

The agent gets pictures of the goal, the map that was built while exploring, and the
networks of that run: no position, no plan of the maze. Beside it play an oracle that
walks shortest paths and an agent that acts at random, in the same episodes; and, if
``evaluate.policies`` names them, navigators that are told the truth about one part of
the task, which says where goals are lost. The run folder gets ``summary.csv`` and
``summary.md`` (means, 95 % intervals, and what went wrong), ``episodes.csv``,
``goals.png``, ``success.png``, ``path.png`` and ``walk.mp4``.

In a world without a plan (``world=gym``) it counts the walks that come to the place of
their pictures, by the positions that ``world.position`` gives, beside random walks. It
takes ``navigator=topological``, and writes ``episodes.csv`` and ``summary.csv`` alone.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

import sys
from pathlib import Path

import pandas as pd
import torch

from toponav.builders import load_exploration, make_goal_places
from toponav.config import NavigateConfig, run_setting
from toponav.launch import recipe
from toponav.methods.navigators import CHOSEN, make_policies, warn_of_goals
from toponav.reports import (
    episode_table,
    markdown_summary,
    play_policies,
    summary_row,
    write_goals,
    write_path,
    write_picture_walks,
    write_success,
    write_walk,
)
from toponav.runs import write_history, write_text


@recipe("navigate", aliases={"scale": "navigate"})
def main(settings: NavigateConfig, folder: Path) -> None:
    """Load what was explored, play the episodes, write numbers and pictures."""
    torch.set_num_threads(settings.threads or torch.get_num_threads())
    torch.manual_seed(settings.seed)

    # Without the plan of a maze there is no oracle, and positions alone judge.
    if run_setting(settings.run, "world.name", "maze") != "maze":
        said = write_picture_walks(settings, folder)
        print(f"{said}written to {folder}")
        return

    # What the exploration left, and the goals with their pictures.
    knowledge, truth = load_exploration(settings)
    places = make_goal_places(settings, knowledge, truth)

    # All policies play the same episodes.
    policies = make_policies(settings, knowledge, truth)
    for sentence in warn_of_goals(settings, policies, places):
        print(sentence, file=sys.stderr)
    played = play_policies(settings, truth, places, policies)

    # Numbers: an episode a row, and a policy a row.
    closed = ", ".join(settings.maze.blocked) or "nothing"
    title = f"{truth.layout.name}, {closed} closed"
    slow = settings.evaluate.slow
    rows = [summary_row(one, truth, places, slow=slow) for one in played]
    summary = markdown_summary(rows, title=title)
    write_history(folder / "summary.csv", rows)
    write_text(folder / "summary.md", summary)
    episodes = pd.concat([episode_table(one) for one in played])
    write_text(
        folder / "episodes.csv", episodes.to_csv(index=False, float_format="%.6g")
    )

    # Pictures: how soon, one path on the plan, and what the agent saw.
    write_success(folder, played, title=title)
    write_goals(folder, rows, title=title)
    for one in played:
        if one.policy == CHOSEN:
            write_path(folder, one, knowledge, truth)
            if settings.video.decisions:
                write_walk(folder, one, knowledge, truth, settings.video)
    print(f"{summary}written to {folder}")


if __name__ == "__main__":
    main()
