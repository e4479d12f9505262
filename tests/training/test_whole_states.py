"""A state whose parts do not fit each other is never written."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.training.test_map_growth import make_growth, make_walk, settings
from toponav.config import TrainingError
from toponav.training import ExplorationState, MapGrowth, save_exploration
from toponav.training.whole_states import require_whole

#: Of one batch of `make_walk`.
DECISIONS = 128


def grown(folder: Path | None = None, *settings_: str) -> MapGrowth:
    """A map with edges, walks and true poses, after one batch."""
    config = settings("map.poses=true", *settings_)
    growth = make_growth(config, folder)
    growth.extend(make_walk(config))
    return growth


@pytest.fixture(scope="module")
def states() -> dict[str, Any]:
    """Of a log and of a map, which fit each other."""
    state = grown().state_dict()
    assert len(state["map"]["edges"]) > 1
    assert len(state["walks"]["walks"]) == 4
    return {"episodes": {"decisions": DECISIONS}, "map": state}


def test_parts_that_fit_are_saved(states: dict[str, Any], tmp_path: Path) -> None:
    require_whole(DECISIONS, states)
    # A run without networks has no map, and what is new in a run begins at 0.
    require_whole(DECISIONS, {"episodes": states["episodes"], "learner": {}})
    require_whole(0, {"map": make_growth(settings("map.poses=false")).state_dict()})
    require_whole(DECISIONS, {"map": grown(tmp_path).state_dict()})
    # Of networks that change, embeddings are made again.
    online = grown(tmp_path, "online.learn=true").state_dict()
    assert "embeddings" not in online["map"]
    require_whole(DECISIONS, {"map": online})


def shorter(*path: Any) -> Callable[[dict[str, Any]], None]:
    """What takes the last row from the array under this path of keys."""

    def change(states: dict[str, Any]) -> None:
        for key in path[:-1]:
            states = states[key]
        states[path[-1]] = states[path[-1]][:-1]

    return change


def last_edge_to_nowhere(states: dict[str, Any]) -> None:
    states["map"]["map"]["edges"][-1, 1] = 10_000


@pytest.mark.parametrize(
    ("damage", "what"),
    [
        (lambda states: states["episodes"].update(decisions=96), "decisions"),
        (shorter("map", "truth", "poses"), "waypoints"),
        (shorter("map", "map", "embeddings"), "waypoints"),
        (shorter("map", "map", "origins"), "waypoints"),
        (shorter("map", "map", "images"), "waypoints"),
        (last_edge_to_nowhere, "waypoints"),
        (lambda states: states["map"]["growth"].append((DECISIONS, 1)), "waypoints"),
        (shorter("map", "map", "traversals"), "edges"),
        (shorter("map", "walks", "walks", 0, "actions"), "views in the walks"),
        (shorter("map", "walks", "walks"), "views in the walks"),
    ],
)
def test_parts_that_do_not_fit_are_one_sentence(
    damage: Callable[[dict[str, Any]], None], what: str, states: dict[str, Any]
) -> None:
    damaged = copy.deepcopy(states)
    damage(damaged)
    sentence = rf"^what a run saves must have one number of {what}, got .*; its last"
    with pytest.raises(TrainingError, match=sentence):
        require_whole(DECISIONS, damaged)


def test_what_was_interrupted_in_mid_batch_replaces_no_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    growth, state = grown(), ExplorationState(decisions=DECISIONS)
    save_exploration(tmp_path, state, {"map": growth})
    kept = (tmp_path / "checkpoint.pt").read_bytes()

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    # Between a map's waypoints and the poses of these.
    monkeypatch.setattr(growth.truth, "place", stop)
    with pytest.raises(KeyboardInterrupt):
        growth.extend(make_walk(settings(), seed=1, start=32))
    with pytest.raises(TrainingError, match="one number of waypoints, got"):
        save_exploration(tmp_path, state, {"map": growth})
    assert (tmp_path / "checkpoint.pt").read_bytes() == kept
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
