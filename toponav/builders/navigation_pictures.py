"""The pictures and the video of an evaluation of navigators."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from toponav.builders.navigation import Explored
from toponav.builders.navigation_evaluation import Played
from toponav.config import NavigateConfig
from toponav.evaluation import (
    Leg,
    draw_leg,
    draw_plan,
    draw_success,
    find_legs,
    first_goal,
    navigated_frames,
    write_video,
)
from toponav.graph import Planner


def write_success(folder: Path, played: Sequence[Played], *, title: str) -> None:
    """Draw ``success.png``: episodes that reached their goal, over the decisions."""
    first = {one.policy: first_goal(one.trace) for one in played}
    decisions = played[0].trace.decisions
    figure = draw_success(first, decisions=decisions, title=title)
    figure.savefig(folder / "success.png", dpi=130)


def write_leg(folder: Path, played: Played, explored: Explored) -> None:
    """Draw ``way.png``: of the legs that reached their goal the one with most cuts.

    Without any that did, the first leg of the first episode.
    """
    trace = played.trace
    cut = trace.cut_from >= 0

    def telling(leg: Leg) -> tuple[bool, int, int]:
        cuts = int(cut[leg.episode, leg.start : leg.end].sum())
        return leg.reached, cuts, -leg.decisions

    leg = max(find_legs(trace), key=telling)
    span = (leg.episode, slice(leg.start, leg.end))
    at = (leg.episode, leg.start)
    cuts = np.stack([trace.cut_from[span], trace.cut_to[span]], 1)[cut[span]]
    figure = draw_leg(
        trace.positions[span],
        float(trace.headings[at]),
        draw=partial(
            draw_plan,
            open_mask=torch.as_tensor(explored.layout.open_mask),
            slots=explored.layout.slots,
            closed=_closed(explored, trace.blocked[at]),
            goal=(int(trace.goal_cells[at][0]), int(trace.goal_cells[at][1])),
        ),
        waypoints=explored.poses[:, :2],
        edges=explored.map.edges[explored.map.edge_cost.amin(1) <= 1],
        planned=_first_plan(explored, trace.place[span], trace.goal_node[span]),
        cuts=cuts,
        title=f"episode {leg.episode}: {leg.decisions} decisions, "
        f"{'reached' if leg.reached else 'not reached'}, {len(cuts)} cuts",
    )
    figure.savefig(folder / "way.png", dpi=130)


def _closed(explored: Explored, blocked: np.ndarray) -> list[str]:
    letters = list(explored.layout.slots)
    return [letter for letter, shut in zip(letters, blocked, strict=True) if shut]


def _first_plan(explored: Explored, places: np.ndarray, goals: np.ndarray) -> list[int]:
    """The waypoints of the first plan of a leg, closed edges not considered."""
    known = np.flatnonzero((places >= 0) & (goals >= 0))
    if not len(known):
        return []
    place, goal = int(places[known[0]]), int(goals[known[0]])
    grown = explored.map
    onward = Planner(grown.num_waypoints, grown.edges, grown.edge_cost).plan([goal])
    path = [place]
    while (following := int(onward.onward[path[-1]])) != path[-1]:
        path.append(following)
    return path


def write_walk(
    folder: Path, played: Played, explored: Explored, config: NavigateConfig
) -> None:
    """Write ``walk.mp4``: view, target, goal and plan of the first episode's begin."""
    shown, trace = len(played.views), played.trace
    at = (0, 0)
    frames = navigated_frames(
        trace.positions[0, :shown],
        trace.headings[0, :shown],
        np.asarray(played.views),
        _target_views(played, explored, shown),
        played.goal,
        draw=partial(
            draw_plan,
            open_mask=torch.as_tensor(explored.layout.open_mask),
            slots=explored.layout.slots,
            closed=_closed(explored, trace.blocked[at]),
            goal=(int(trace.goal_cells[at][0]), int(trace.goal_cells[at][1])),
        ),
        captions=_captions(played, shown),
        height=config.video.height,
    )
    write_video(folder / f"walk.{config.video.format}", frames)


def _target_views(
    played: Played, explored: Explored, shown: int
) -> list[Tensor | None]:
    """What the agent walked to: a waypoint's view, the goal's, nothing if lost."""
    trace = played.trace
    views: list[Tensor | None] = []
    for decision in range(shown):
        target = int(trace.target[0, decision])
        if trace.lost[0, decision] or trace.place[0, decision] < 0:
            views.append(None)
        else:
            views.append(played.goal if target < 0 else explored.map.images[target])
    return views


def _captions(played: Played, shown: int) -> list[str]:
    trace = played.trace
    goals = np.concatenate([[0], trace.reached[0].cumsum()])
    cuts = (trace.cut_from[0] >= 0).cumsum()
    return [
        f"decision {decision}   goals {goals[decision]}   place "
        f"{trace.place[0, decision]}   walks to {trace.target[0, decision]}   cuts "
        f"{cuts[decision]}"
        for decision in range(shown)
    ]
