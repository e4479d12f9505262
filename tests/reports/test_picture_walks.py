"""Who comes to pictures where there is no plan, and which pictures are shown."""

import math
import re
from pathlib import Path

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from tests.composed import settings as compose
from tests.exploring import explore_settings
from toponav.config import NavigateConfig, SettingsError
from toponav.methods import make_world
from toponav.reports.picture_walks import (
    _summary,
    choose_goals,
    judge_walks,
    write_picture_walks,
)

WORLD = ("world=gym", "world.id=tests.foreign_world:ForeignWorld-v0")
WHERE = "world.position=[_cell.0,_cell.1]"


def navigate_settings(*words: str) -> NavigateConfig:
    found = compose(
        "navigate", "maze=maze1", "maze.goal=true", "navigate=smoke", *words
    )
    assert isinstance(found, NavigateConfig)
    return found


def test_a_goal_is_a_place_that_a_walk_entered_and_pictures_are_from_there() -> None:
    world = make_world(explore_settings(*WORLD, WHERE))
    config = navigate_settings("evaluate.episodes=5", "goals.views=3")
    goals, again = choose_goals(config, world), choose_goals(config, world)
    assert goals.views.shape == (5, 3, 48, 64, 3)
    assert torch.equal(goals.views, again.views)
    # A view names its square in this world.
    assert (goals.views == goals.views[:, :1]).all()
    assert len(goals.squares.unique(dim=0)) > 1


def test_only_the_first_episode_counts() -> None:
    x = torch.tensor([[0, 1, 2, 3], [0, 0, 2, 0], [1, 0, 0, 0]]).float()
    done = torch.zeros(3, 4, 1, dtype=torch.bool)
    done[1, 1] = True
    done[0, 2] = True  # the end comes with the place
    later = {("privileged", "position"): torch.stack([x, 0 * x], -1), "done": done}
    frames = TensorDict({"next": TensorDict(later, [3, 4])}, [3, 4])
    squares = torch.tensor([[2, 0], [2, 0], [5, 0]])
    table = judge_walks(frames, squares, 1.0, policy="sticky")
    assert table.reached.tolist() == [1, 0, 0]
    assert table.decisions.tolist() == [3, -1, -1]
    assert set(table.policy) == {"sticky"}


@pytest.mark.parametrize(
    ("decisions", "median"), [([20, -1, -1], math.nan), ([20, 30, -1], 30.0)]
)
def test_who_does_not_come_counts_as_the_longest(
    decisions: list[int], median: float
) -> None:
    reached = [int(one >= 0) for one in decisions]
    table = pd.DataFrame({"reached": reached, "decisions": decisions})
    row = _summary("navigator", table)
    assert row["reached"] == sum(reached)
    assert row["median_decisions"] == pytest.approx(median, nan_ok=True)


@pytest.mark.parametrize("size", [2.0, 0.5])
def test_places_are_squares_of_a_size(size: float) -> None:
    position = torch.tensor([[[0.0, 0.0], [1.0, 0.0]]])
    later = {("privileged", "position"): position, "done": torch.zeros(1, 2, 1).bool()}
    frames = TensorDict({"next": TensorDict(later, [1, 2])}, [1, 2])
    goal = (torch.tensor([[1.0, 0.0]]) / size).floor().long()
    table = judge_walks(frames, goal, size, policy="random")
    assert table.decisions.tolist() == [1 if size == 2 else 2]


@pytest.mark.parametrize(
    ("where", "words", "sentence"),
    [
        (WHERE, ["navigator=poses"], "navigator must be topological in world=gym"),
        (WHERE, ["maze.blocked=[a]"], "maze.blocked must be empty in world=gym"),
        ("seed=0", [], "run must name an exploration with world.position"),
        (WHERE, [], "run must name an exploration with networks and a map"),
    ],
)
def test_what_cannot_be_walked_or_judged_is_refused(
    where: str, words: list[str], sentence: str, tmp_path: Path
) -> None:
    explored = OmegaConf.structured(explore_settings(*WORLD, where, "reward=random"))
    (tmp_path / "config").mkdir()
    OmegaConf.save(explored, tmp_path / "config" / "config.yaml")
    config = navigate_settings(f"run={tmp_path}", *words)
    with pytest.raises(SettingsError, match=re.escape(sentence)):
        write_picture_walks(config, tmp_path)
