"""The pictures and the video of an evaluation of navigators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from toponav.builders import AgentKnowledge, GroundTruth
from toponav.config import NavigateVideoConfig
from toponav.graph import Planner
from toponav.metrics import find_legs, first_goal
from toponav.plotting import (
    FloorPlan,
    draw_leg,
    draw_success,
    navigated_frames,
    save_figure,
    write_video,
)
from toponav.reports.navigation_evaluation import NavigationEpisodes


def write_success(
    folder: Path, played: Sequence[NavigationEpisodes], *, title: str
) -> None:
    """Draw ``success.png``: episodes that reached their goal, over the decisions."""
    first = {one.policy: first_goal(one.trace) for one in played}
    decisions = played[0].trace.decisions
    figure = draw_success(first, decisions=decisions, title=title)
    save_figure(figure, folder / "success.png")


def write_path(
    folder: Path,
    episodes: NavigationEpisodes,
    knowledge: AgentKnowledge,
    truth: GroundTruth,
) -> None:
    """Draw ``path.png``: of the legs that reached their goal the one with most cuts.

    Without any that did, the first leg of the first episode.
    """
    trace = episodes.trace
    is_cut = trace.cut_from >= 0

    def interest(leg: Any) -> tuple[bool, int, int]:
        cuts = int(is_cut[leg.episode, leg.start : leg.end].sum())
        return leg.reached, cuts, -leg.decisions

    leg = max(find_legs(trace).itertuples(), key=interest)
    span = (leg.episode, slice(leg.start, leg.end))
    cuts = np.stack([trace.cut_from[span], trace.cut_to[span]], 1)[is_cut[span]]
    figure = draw_leg(
        trace.positions[span],
        float(trace.headings[leg.episode, leg.start]),
        plan=_make_floor_plan(episodes, truth, leg.episode, leg.start),
        waypoints=truth.poses[:, :2],
        edges=knowledge.map.edges[(knowledge.map.graph.traversals > 0).any(1)],
        planned=_first_plan(episodes, leg),
        cuts=cuts,
        title=f"episode {leg.episode}: {leg.decisions} decisions, "
        f"{'reached' if leg.reached else 'not reached'}, {len(cuts)} cuts",
    )
    save_figure(figure, folder / "path.png")


def _make_floor_plan(
    episodes: NavigationEpisodes, truth: GroundTruth, episode: int, decision: int
) -> FloorPlan:
    """The maze with the goal and the closed slots of a decision."""
    trace, layout = episodes.trace, truth.layout
    slots = zip(layout.slots, trace.blocked[episode, decision], strict=True)
    row, column = trace.goal_cells[episode, decision].tolist()
    return FloorPlan(
        torch.as_tensor(layout.open_mask),
        cell_size=truth.distances.cell_size,
        slots=layout.slots,
        closed=[letter for letter, is_closed in slots if is_closed],
        goal=(row, column),
    )


def _first_plan(episodes: NavigationEpisodes, leg: Any) -> list[int]:
    """The waypoints of the first plan of a leg, with no edge closed."""
    span = (leg.episode, slice(leg.start, leg.end))
    places, goals = episodes.trace.place[span], episodes.trace.goal_node[span]
    known = np.flatnonzero((places >= 0) & (goals >= 0))
    graph = episodes.map
    if graph is None or not len(known):
        return []
    planner = Planner(graph.num_waypoints, graph.edges, graph.edge_cost)
    onward = planner.plan([int(goals[known[0]])]).onward.tolist()
    path = [int(places[known[0]])]
    while onward[path[-1]] != path[-1]:
        path.append(onward[path[-1]])
    return path


def write_walk(
    folder: Path,
    episodes: NavigationEpisodes,
    knowledge: AgentKnowledge,
    truth: GroundTruth,
    video: NavigateVideoConfig,
) -> None:
    """Write ``walk.mp4``: view, target, goal and plan as the first episode begins."""
    trace = episodes.trace
    shown = min(len(episodes.views), trace.decisions)
    frames = navigated_frames(
        trace.positions[0, :shown],
        trace.headings[0, :shown],
        np.asarray(episodes.views[:shown]),
        _target_views(episodes, knowledge.map.waypoints.images, shown),
        episodes.goal,
        plan=_make_floor_plan(episodes, truth, 0, 0),
        captions=_captions(episodes, shown),
        height=video.height,
    )
    write_video(folder / f"walk.{video.format}", frames)


def _target_views(
    episodes: NavigationEpisodes, images: Tensor, shown: int
) -> list[Tensor | None]:
    """What the agent walked to: a waypoint's view, the goal's, nothing if lost."""
    trace = episodes.trace
    views: list[Tensor | None] = []
    for decision in range(shown):
        target = int(trace.target[0, decision])
        if trace.lost[0, decision] or trace.place[0, decision] < 0:
            views.append(None)
        else:
            views.append(episodes.goal if target < 0 else images[target])
    return views


def _captions(episodes: NavigationEpisodes, shown: int) -> list[str]:
    trace = episodes.trace
    goals = np.concatenate([[0], trace.reached[0].cumsum()])
    cuts = (trace.cut_from[0] >= 0).cumsum()
    return [
        f"decision {decision}   goals {goals[decision]}   place "
        f"{trace.place[0, decision]}   walks to {trace.target[0, decision]}   cuts "
        f"{cuts[decision]}"
        for decision in range(shown)
    ]
