"""Rows and videos of an evaluation whose world ends episodes early."""

from pathlib import Path
from unittest.mock import Mock

import pytest
import torch
from tensordict import TensorDict

from toponav.keys import INTRINSIC_REWARD, PLACES
from toponav.reports import exploration_evaluation
from toponav.reports.exploration_evaluation import Evaluation, write_episode_video


def ended_early() -> Evaluation:
    """Ten decisions, a reward of t at decision t; the first world ends after four.

    What has been visited starts again with the next episode: 1 to 4, 1 to 6; 1 to 10.
    """
    done = torch.zeros(2, 10, 1, dtype=torch.bool)
    done[0, 3] = True
    reward = torch.arange(10.0).expand(2, 10).unsqueeze(-1)
    places = torch.arange(1, 11).repeat(2, 1)
    places[0, 4:] = torch.arange(1, 7)
    later = {"done": done, INTRINSIC_REWARD: reward, PLACES: places.unsqueeze(-1)}
    frames = TensorDict({"next": TensorDict(later, [2, 10])}, [2, 10])
    views = torch.arange(0, 11, 6).reshape(-1, 1, 1, 1).to(torch.uint8)
    return Evaluation("best", frames, views.expand(-1, 16, 16, 3), INTRINSIC_REWARD)


def test_a_row_is_of_the_first_episode_alone() -> None:
    first, second = ended_early().rows()
    # 0 + 1 + 2 + 3, and 0 + ... + 9.
    assert (first["intrinsic_return"], second["intrinsic_return"]) == (6.0, 45.0)
    assert (first["places"], second["places"]) == (4, 10)


def test_the_video_ends_with_the_first_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Mock()
    monkeypatch.setattr(exploration_evaluation, "write_video", write)
    write_episode_video(tmp_path, Mock(layout=None), ended_early())
    # The views of decisions 0 and 6: the episode ends with decision 3.
    (path, frames), _ = write.call_args
    assert path == tmp_path / "episode.mp4"
    assert [int(view.max()) for view in frames] == [0]
