"""The pictures of an exploration, drawn while it runs and at its end."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch

from toponav.builders import World
from toponav.ground_truth import require_motion
from toponav.metrics import trace_episode
from toponav.plotting import (
    FloorPlan,
    draw_exploration,
    draw_training,
    explored_frames,
    save_figure,
    write_video,
)
from toponav.reports.exploration_evaluation import Evaluation
from toponav.training import EpisodeLog, Row

# Decisions from frame to frame of a video.
_EVERY = 6


def write_training_curves(
    folder: Path,
    history: Sequence[Row],
    episodes: Sequence[Row],
    *,
    levels: dict[str, float],
    title: str,
) -> None:
    """Draw ``curves.png``: coverage and return over the run, losses, waypoints.

    Args:
        folder: the run folder.
        history: rows of ``metrics.csv``.
        episodes: rows of ``episodes.csv``.
        levels: coverage of the blind baselines, by name.
        title: over the picture.
    """
    figure = draw_training(
        _columns(episodes), _columns(history), levels=levels, title=title
    )
    save_figure(figure, folder / "curves.png")


def write_map(folder: Path, world: World, log: EpisodeLog) -> None:
    """Draw ``map.png``: the last episode from above, coloured by its reward."""
    assert log.last_episode is not None
    trace = trace_episode(log.last_episode, reward=log.sums["intrinsic_return"])
    figure = draw_exploration(trace, make_plan(world))
    save_figure(figure, folder / "map.png")


def write_episode_video(folder: Path, world: World, evaluation: Evaluation) -> None:
    """Write ``episode.mp4``: the first episode of an evaluation, view beside plan.

    Without ground truth there is no plan, and the video shows the views.
    """
    views = evaluation.views[::_EVERY]
    path = folder / "episode.mp4"
    if world.layout is None:
        write_video(path, iter(views.numpy()))
        return
    trace = trace_episode(evaluation.episodes[0], reward=evaluation.reward_key)
    plan = make_plan(world)
    write_video(path, explored_frames(trace, views, plan=plan, every=_EVERY))


def make_plan(world: World) -> FloorPlan:
    """The plan of a maze to draw on."""
    assert world.layout is not None
    mask = torch.as_tensor(world.layout.open_mask)
    return FloorPlan(mask, cell_size=require_motion(world.spec).cell_size)


def _columns(rows: Sequence[Row]) -> dict[str, list[float]]:
    """A table by columns; a measurement that came late is NaN before."""
    names = rows[-1] if rows else ()
    return {name: [row.get(name, math.nan) for row in rows] for name in names}
