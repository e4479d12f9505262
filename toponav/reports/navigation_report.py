"""Navigators and those they are compared with: their episodes, numbers, pictures."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from torch import Tensor

from toponav import metrics, plotting
from toponav.builders import (
    AgentKnowledge,
    GoalPlaces,
    GroundTruth,
)
from toponav.config import NavigateVideoConfig
from toponav.graph import Planner
from toponav.reports.navigation_episodes import NavigationEpisodes
from toponav.training import Row

#: Decisions within which success is reported.
WITHIN = (250, 500, 1250, 5000)


def episode_table(episodes: NavigationEpisodes) -> pd.DataFrame:
    """A row of ``episodes.csv`` for each episode."""
    trace = episodes.trace
    return pd.DataFrame(
        {
            "policy": episodes.policy,
            "episode": np.arange(len(trace)),
            "goals": trace.reached.sum(1),
            "reward": trace.reward.sum(1),
            "first_goal": metrics.first_goal(trace),
            "spl": metrics.success_weighted_by_length(episodes.legs),
            "replans": (trace.cut_from >= 0).sum(1),
            "lost": trace.lost.mean(1),
        }
    )


def summary_row(
    episodes: NavigationEpisodes, truth: GroundTruth, places: GoalPlaces, *, slow: int
) -> Row:
    """A row of ``summary.csv``: means with their 95 % intervals, and what went wrong.

    Faults are of an agent with a map, NaN for the others; ``slow`` is the number of
    decisions to a goal beyond which the reason is looked for.
    """
    table, trace = episode_table(episodes), episodes.trace
    measured = {name: table[name] for name in ("goals", "reward", "spl", "replans")}
    first = table["first_goal"]
    for time in [t for t in WITHIN if t <= trace.decisions] or [trace.decisions]:
        measured[f"success_{time}"] = first.between(0, time)
    row: Row = {"policy": episodes.policy, "episodes": len(trace)}
    for name, values in measured.items():
        found = metrics.bootstrap(values)
        row |= {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
    row["detour"] = metrics.mean_detour(
        episodes.legs, shortest=truth.distances.cell_size
    )
    faults = _fault_numbers(trace, truth, slow=slow)
    return row | faults | {"places_without_picture": places.num_without}


def _fault_numbers(
    trace: metrics.NavigationTrace, truth: GroundTruth, *, slow: int
) -> Row:
    distances = truth.distances
    waypoints = np.asarray(truth.poses[:, :2], np.float64)
    cuts = metrics.judge_cuts(trace, distances, waypoints)
    delays = metrics.detection_delays(trace, distances, cuts)
    numbers: Row = {
        f"cuts_{verdict}": int((cuts.verdict == verdict).sum())
        for verdict in ("blockage", "false_edge", "false_block")
    }
    numbers["detection_delay"] = float(np.median(delays)) if len(delays) else math.nan
    has_map = bool((trace.place >= 0).any())
    faults = metrics.classify_decisions(trace, distances, waypoints)
    slow_by = metrics.slow_legs(trace, faults, limit=slow)
    for number, name in enumerate(slow_by):
        share = float((faults == number).mean()) if has_map else math.nan
        numbers[f"decisions_{name}"] = share
        numbers[f"slow_{name}"] = slow_by[name] if has_map else math.nan
    return numbers


def markdown_summary(rows: Sequence[Row], *, title: str) -> str:
    """All numbers as a table, a policy a column, with 95 % intervals.

    Examples:
        >>> row = {"policy": "oracle", "goals": 133.0, "goals_low": 130.0}
        >>> row |= {"goals_high": 136.25, "detour": 1.25}
        >>> print(markdown_summary([row], title="maze1"))
        maze1
        <BLANKLINE>
        |        | oracle             |
        |--------|--------------------|
        | goals  | 133 (130 to 136.2) |
        | detour | 1.25               |
        <BLANKLINE>
    """
    ends = ("_low", "_high")
    names = [name for name in rows[0] if name != "policy" and not name.endswith(ends)]
    table = pd.DataFrame({"": names})
    for row in rows:
        table[row["policy"]] = [_cell(row, name) for name in names]
    return f"{title}\n\n{metrics.aligned_table(table)}"


def _cell(row: Row, name: str) -> str:
    ends = (row.get(f"{name}{end}", math.nan) for end in ("", "_low", "_high"))
    middle, low, high = map(float, ends)
    interval = "" if math.isnan(low) or low == high else f" ({low:.4g} to {high:.4g})"
    return "" if math.isnan(middle) else f"{middle:.4g}{interval}"


def write_success(
    folder: Path, played: Sequence[NavigationEpisodes], *, title: str
) -> None:
    """Draw ``success.png``: episodes that reached their goal, over the decisions."""
    first = {one.policy: metrics.first_goal(one.trace) for one in played}
    figure = plotting.draw_success(
        first, decisions=played[0].trace.decisions, title=title
    )
    plotting.save_figure(figure, folder / "success.png")


def write_goals(folder: Path, rows: Sequence[Row], *, title: str) -> None:
    """Draw ``goals.png``: the goals of each policy, from its rows of the summary."""
    goals = {
        str(row["policy"]): (
            float(row["goals"]),
            float(row["goals_low"]),
            float(row["goals_high"]),
        )
        for row in rows
    }
    figure = plotting.draw_goals(goals, best="oracle", title=title)
    plotting.save_figure(figure, folder / "goals.png")


def write_path(
    folder: Path,
    episodes: NavigationEpisodes,
    knowledge: AgentKnowledge,
    truth: GroundTruth,
) -> None:
    """Draw ``path.png``: of the legs that reached their goal the one with most cuts.

    Without any that did, of all legs. Of several with as many cuts, such as none, it is
    the one of median length.
    """
    trace, known = episodes.trace, knowledge.map
    leg = _leg_to_show(trace)
    cuts, reached = _cuts_of(trace, leg), "reached" if leg.reached else "not reached"
    title = f"episode {leg.episode}: {leg.decisions} decisions, {reached}, "
    figure = plotting.draw_leg(
        trace.positions[leg.episode, leg.start : leg.end],
        float(trace.headings[leg.episode, leg.start]),
        plan=_make_floor_plan(episodes, truth, leg.episode, leg.start),
        waypoints=truth.poses[:, :2],
        edges=known.edges[(known.graph.traversals > 0).any(1)],
        planned=_first_plan(episodes, leg),
        cuts=cuts,
        title=f"{title}{len(cuts)} cuts",
    )
    plotting.save_figure(figure, folder / "path.png")


def _leg_to_show(trace: metrics.NavigationTrace) -> Any:
    """The leg that `write_path` draws, as ``itertuples`` has it."""
    legs = list(metrics.find_legs(trace).itertuples())
    interest = [(leg.reached, len(_cuts_of(trace, leg))) for leg in legs]
    best = max(interest)
    most = [leg for leg, of in zip(legs, interest, strict=True) if of == best]
    return sorted(most, key=lambda leg: leg.decisions)[len(most) // 2]


def _cuts_of(trace: metrics.NavigationTrace, leg: Any) -> np.ndarray:
    """The ends ``[C, 2]`` of the edges that were closed in a leg."""
    span = (leg.episode, slice(leg.start, leg.end))
    cuts = np.stack([trace.cut_from[span], trace.cut_to[span]], 1)
    return cuts[cuts[:, 0] >= 0]


def _make_floor_plan(
    episodes: NavigationEpisodes, truth: GroundTruth, episode: int, decision: int
) -> plotting.FloorPlan:
    """The maze with the goal and the closed slots of a decision."""
    trace, layout = episodes.trace, truth.layout
    slots = zip(layout.slots, trace.blocked[episode, decision], strict=True)
    row, column = trace.goal_cells[episode, decision].tolist()
    return plotting.FloorPlan(
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
    trace, shown = episodes.trace, min(len(episodes.views), episodes.trace.decisions)
    targets, captions = list[Tensor | None](), list[str]()
    goals = np.concatenate([[0], trace.reached[0].cumsum()])
    cuts = (trace.cut_from[0] >= 0).cumsum()
    for now in range(shown):
        place, target = trace.place[0, now], trace.target[0, now]
        captions.append(
            f"decision {now}   goals {goals[now]}   place {place}   walks to {target}"
            f"   cuts {cuts[now]}"
        )
        view = episodes.goal if target < 0 else knowledge.map.waypoints.images[target]
        targets.append(None if trace.lost[0, now] or place < 0 else view)
    frames = plotting.navigated_frames(
        trace.positions[0, :shown],
        trace.headings[0, :shown],
        np.asarray(episodes.views[:shown]),
        targets,
        episodes.goal,
        plan=_make_floor_plan(episodes, truth, 0, 0),
        captions=captions,
        height=video.height,
    )
    plotting.write_video(folder / f"walk.{video.format}", frames)
