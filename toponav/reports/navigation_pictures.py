"""The pictures and the video of an evaluation of navigators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
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
    figure = draw_success(first, decisions=played[0].trace.decisions, title=title)
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
    trace, known = episodes.trace, knowledge.map

    def cuts_of(leg: Any) -> np.ndarray:
        span = (leg.episode, slice(leg.start, leg.end))
        cuts = np.stack([trace.cut_from[span], trace.cut_to[span]], 1)
        return cuts[cuts[:, 0] >= 0]

    def interest(leg: Any) -> tuple[bool, int, int]:
        return leg.reached, len(cuts_of(leg)), -leg.decisions

    leg = max(find_legs(trace).itertuples(), key=interest)
    cuts, reached = cuts_of(leg), "reached" if leg.reached else "not reached"
    figure = draw_leg(
        trace.positions[leg.episode, leg.start : leg.end],
        float(trace.headings[leg.episode, leg.start]),
        plan=_make_floor_plan(episodes, truth, leg.episode, leg.start),
        waypoints=truth.poses[:, :2],
        edges=known.edges[(known.graph.traversals > 0).any(1)],
        planned=_first_plan(episodes, leg),
        cuts=cuts,
        title=f"episode {leg.episode}: {leg.decisions} decisions, {reached}, "
        f"{len(cuts)} cuts",
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
        layout.open_mask,
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
    trace, goal = episodes.trace, episodes.goal
    shown = min(len(episodes.views), trace.decisions)
    targets: list[Tensor | None] = []
    captions = []
    goals = np.concatenate([[0], trace.reached[0].cumsum()])
    cuts = (trace.cut_from[0] >= 0).cumsum()
    for now in range(shown):
        place, target = trace.place[0, now], trace.target[0, now]
        captions.append(
            f"decision {now}   goals {goals[now]}   place {place}   walks to {target}"
            f"   cuts {cuts[now]}"
        )
        view = goal if target < 0 else knowledge.map.waypoints.images[target]
        targets.append(None if trace.lost[0, now] or place < 0 else view)
    frames = navigated_frames(
        trace.positions[0, :shown],
        trace.headings[0, :shown],
        np.asarray(episodes.views[:shown]),
        targets,
        goal,
        plan=_make_floor_plan(episodes, truth, 0, 0),
        captions=captions,
        height=video.height,
    )
    write_video(folder / f"walk.{video.format}", frames)
