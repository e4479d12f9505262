"""Walk to goals over the map of an exploration, through blockages too.

    python recipes/navigate.py run=runs/explore/maze1-... maze=maze1
    python recipes/navigate.py -m run=... maze=maze1 'maze.blocked=[],[a],[b],[a,b]'

The agent gets pictures of the goal, the map that grew while exploring, and the
networks of that run: no position, no plan of the maze. Beside it play an oracle that
walks shortest ways and an agent that acts at random, in the same episodes. The run
folder gets ``summary.csv`` and ``summary.md`` (means, 95 % intervals, and what went
wrong), ``episodes.csv``, ``success.png``, ``way.png`` and ``walk.mp4``.
"""

import sys
from pathlib import Path

import torch

from toponav.builders import (
    closed_letters,
    episode_rows,
    find_lost_goals,
    load_explored,
    make_goal_places,
    make_navigator,
    make_policies,
    markdown_summary,
    play_policies,
    summary_row,
    write_history,
    write_leg,
    write_success,
    write_text,
    write_walk,
)
from toponav.config import NavigateConfig
from toponav.launch import recipe


@recipe("navigate")
def main(settings: NavigateConfig, folder: Path) -> None:
    """Load what was explored, play the episodes, write numbers and pictures."""
    torch.set_num_threads(settings.threads or torch.get_num_threads())
    torch.manual_seed(settings.seed)

    # What the exploration left, and the goals with their pictures.
    explored = load_explored(settings)
    places = make_goal_places(settings, explored)
    navigator = make_navigator(settings.navigator, explored, seed=settings.seed)
    if sentence := find_lost_goals(navigator, places):
        print(sentence, file=sys.stderr)

    # The same episodes for all who play.
    policies = make_policies(settings, explored, navigator)
    played = play_policies(settings, explored, places, policies)

    # Numbers: an episode a row, and a policy a row.
    title = f"{explored.layout.name}, {closed_letters(settings.maze.blocked)}"
    rows = [summary_row(one, explored, settings) for one in played]
    summary = markdown_summary(rows, title=title)
    write_history(folder / "summary.csv", rows)
    write_text(folder / "summary.md", f"{summary}\n")
    episodes = [row for one in played for row in episode_rows(one)]
    write_history(folder / "episodes.csv", episodes)

    # Pictures: how soon, one way on the plan, and what the agent saw.
    write_success(folder, played, title=title)
    for one in played:
        if one.policy == "navigator":
            write_leg(folder, one, explored)
            if settings.video.decisions:
                write_walk(folder, one, explored, settings)
    print(f"{summary}\nwritten to {folder}")


if __name__ == "__main__":
    main()
