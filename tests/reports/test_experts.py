"""Episodes of the frontier expert are played once and found again."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.exploring import explore_settings, world_of
from toponav.reports import SCRIPTED, experts, scripted_rows

ROW = {"policy": "frontier", "seed": 0, "coverage": 1.0}
ROWS = [ROW, ROW | {"seed": 1}]


def settings_of(tmp_path: Path):
    return explore_settings(
        "maze=maze1",
        "maze.episode_length=400",
        "evaluate.random_episodes=2",
        f"evaluate.random_folder={tmp_path}/kept",
    )


def test_episodes_are_played_and_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = settings_of(tmp_path)
    world = world_of(config)
    assert scripted_rows(config, world, ["frontier"], play=False) == []
    rows = scripted_rows(config, world, SCRIPTED)
    names = ["random", "random", "sticky", "sticky", "frontier", "frontier"]
    assert [row["policy"] for row in rows] == names
    # It knows the maze: 400 decisions are enough for most of the cells.
    assert min(row["coverage"] for row in rows[-2:]) > 0.9
    assert not [*Path(tmp_path, "kept").glob(".*")]

    def never(*_: object) -> None:
        raise AssertionError("played again")

    with monkeypatch.context() as patched:
        patched.setattr(experts, "_play", never)
        # As text, since nan is not equal to itself.
        assert repr(scripted_rows(config, world, SCRIPTED)) == repr(rows)
        again = scripted_rows(config, world, ["frontier"], play=False)
        assert repr(again) == repr(rows[-2:])
    # A damaged file is as good as none, and so is one of another maze.
    (file,) = Path(tmp_path, "kept").glob("*-frontier.json")
    other = {"of": {}, "rows": rows[-2:]}
    nobody = file.read_text().replace("policy", "x")
    for text in (
        nobody,
        "",
        "[]",
        "[" * 100_000,
        file.read_text()[:-9],
        json.dumps(other),
    ):
        file.write_text(text)
        assert scripted_rows(config, world, ["frontier"], play=False) == []


def test_two_at_once_play_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = settings_of(tmp_path)
    world, played = world_of(config), []

    def play(*_: object) -> tuple[list[dict[str, object]], bool]:
        played.append(1)
        time.sleep(0.5)
        return ROWS, True

    monkeypatch.setattr(experts, "_play", play)
    with ThreadPoolExecutor(3) as pool:
        found = pool.map(lambda _: scripted_rows(config, world, ["frontier"]), range(3))
        assert [*found] == [ROWS] * 3
    assert len(played) == 1


def test_an_episode_that_lost_its_engine_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = settings_of(tmp_path)
    monkeypatch.setattr(experts, "_play", lambda *_: (ROWS, False))
    assert scripted_rows(config, world_of(config), ["frontier"]) == ROWS
    assert scripted_rows(config, world_of(config), ["frontier"], play=False) == []


def test_where_nothing_can_be_kept_it_plays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kept").touch()
    monkeypatch.setattr(experts, "_play", lambda *_: ([ROW], True))
    config = settings_of(tmp_path)
    assert scripted_rows(config, world_of(config), ["frontier"]) == [ROW]
