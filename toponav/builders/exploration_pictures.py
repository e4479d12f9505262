"""The pictures of an exploration, drawn while it runs and at its end."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from tensordict import TensorDictBase

from toponav.builders.episode_log import Row
from toponav.builders.exploration_evaluation import Evaluation
from toponav.builders.mazes import make_layout
from toponav.config import MazeConfig
from toponav.evaluation import (
    draw_exploration,
    draw_plan,
    draw_training,
    explored_frames,
    trace_episode,
    write_video,
)

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
        levels: coverage of walks to compare with, by name.
        title: over the picture.
    """
    figure = draw_training(
        _columns(episodes), _columns(history), levels=levels, title=title
    )
    figure.savefig(folder / "curves.png", dpi=110)


def write_map(folder: Path, maze: MazeConfig, episode: TensorDictBase) -> None:
    """Draw ``map.png``: an episode ``[T]`` from above, coloured by its reward."""
    mask = torch.as_tensor(make_layout(maze).open_mask)
    figure = draw_exploration(
        trace_episode(episode), mask, draw=partial(draw_plan, open_mask=mask)
    )
    figure.savefig(folder / "map.png", dpi=110)


def write_episode_video(folder: Path, maze: MazeConfig, evaluation: Evaluation) -> None:
    """Write ``episode.mp4``: the first episode of an evaluation, view beside plan."""
    mask = torch.as_tensor(make_layout(maze).open_mask)
    trace = trace_episode(evaluation.episodes[0])
    views = evaluation.views[::_EVERY]
    frames = explored_frames(
        trace, views, draw=partial(draw_plan, open_mask=mask), every=_EVERY
    )
    write_video(folder / "episode.mp4", frames)


def _columns(rows: Sequence[Row]) -> dict[str, list[float]]:
    return {name: [row[name] for row in rows] for name in rows[-1]} if rows else {}
