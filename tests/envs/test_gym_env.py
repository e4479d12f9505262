"""The Gymnasium face of the mazes."""

import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import toponav.envs
from tests.envs.layouts import LANE
from toponav.envs import (
    ENGINES,
    MAZES,
    EngineLostError,
    MazeEnv,
    MazeGymEnv,
    load_maze,
)

IDS = [f"toponav/{name.capitalize()}-v0" for name in MAZES]


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasiums_checker_passes_without_a_warning(env_id: str) -> None:
    env = gymnasium.make(
        env_id, apples=2, goal=True, episode_length=30, render_mode="rgb_array"
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env(env.unwrapped)
    finally:
        env.close()


def test_its_episodes_are_those_of_row_0_of_the_batched_environment() -> None:
    env = MazeGymEnv("maze1", apples=3, goal=True)
    batch = MazeEnv(
        load_maze("maze1"), batch_size=2, apples=3, goal=True, privileged=True, seed=5
    )
    try:
        view, info = env.reset(seed=5)
        data = batch.reset()
        for action in (0, 4, 2, 0, 0, 5, 1):
            np.testing.assert_array_equal(view, data["pixels"][0].numpy())
            np.testing.assert_allclose(
                info["position"], data["privileged", "position"][0].numpy(), rtol=1e-6
            )
            assert info["cell"] == tuple(data["privileged", "cell"][0].tolist())
            view, reward, *_, info = env.step(np.int64(action))
            data["action"] = batch.action_spec.zero() + action
            data = batch.step(data)["next"]
            assert reward == data["reward"][0].item()
    finally:
        env.close()
        batch.close()


def test_only_the_clock_ends_an_episode() -> None:
    env = MazeGymEnv("maze2", episode_length=3)
    try:
        env.reset(seed=0)
        ends = [env.step(np.int64(2))[2:4] for _ in range(3)]
        assert ends == [(False, False), (False, False), (False, True)]
    finally:
        env.close()


def test_a_reset_with_a_seed_begins_the_stream_again() -> None:
    env = MazeGymEnv("maze3")
    try:
        first, _ = env.reset(seed=9)
        second, _ = env.reset()
        assert (first != second).any()
        again, _ = env.reset(seed=9)
        np.testing.assert_array_equal(first, again)
    finally:
        env.close()


@pytest.mark.parametrize("kind", [str, Path])
@pytest.mark.parametrize("name", ["lane.txt", "lane.maze", "lane", "./lane"])
def test_a_layout_file_is_a_maze(
    name: str, kind: type[str | Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(LANE.text)
    env = MazeGymEnv(kind(name), engine="fake")
    try:
        assert env.layout == LANE
        assert env.reset(seed=0)[1]["cell"][0] == 1
    finally:
        env.close()


def test_a_file_does_not_hide_a_maze_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    monkeypatch.chdir(tmp_path)
    Path("maze1").write_text(LANE.text)
    env = MazeGymEnv("maze1", engine="fake")
    env.close()
    assert env.layout == load_maze("maze1")


def test_render_gives_the_view_only_if_asked() -> None:
    env = MazeGymEnv("select", render_mode="rgb_array")
    silent = MazeGymEnv("select")
    try:
        view, _ = env.reset(seed=0)
        assert env.render() is view
        silent.reset(seed=0)
        assert silent.render() is None
    finally:
        env.close()
        silent.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"maze": "maze9"}, "maze must be one of .*got 'maze9'.*did you mean 'maze"),
        (
            {"maze": "mazes/lane"},
            "layout 'mazes/lane': the file must exist, and no such",
        ),
        ({"render_mode": "human"}, "render_mode must be 'rgb_array' or None"),
        (
            {"blocked": ("q",)},
            r"blocked slots must be slots of maze1 \(a, b\), got 'q'",
        ),
        ({"episode_length": 0}, "episode_length must be at least 1, got 0"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MazeGymEnv(**arguments)


def test_importing_the_package_registers_all_mazes() -> None:
    assert toponav.envs.MAZES == MAZES
    assert all(env_id in gymnasium.registry for env_id in IDS)
    assert issubclass(EngineLostError, RuntimeError)
