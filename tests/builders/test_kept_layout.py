"""A layout file that is edited while a run of it goes on."""

import importlib
import signal
from pathlib import Path
from unittest.mock import patch

import pytest

from tests.explored import make_run, navigate_settings
from tests.exploring import explore_settings
from tests.forked import run_forked
from toponav.builders import keep_layout, load_exploration, make_layout
from toponav.config import MazeConfig, SettingsError

RING = "*****\n*   *\n* * *\n*   *\n*****\n"
OPEN = RING.replace("* * *", "*   *")


def own(path: Path, text: str) -> MazeConfig:
    path.write_bytes(text.encode())
    return explore_settings("maze=file", f"maze.path={path}").maze


def test_a_layout_is_kept_and_compared(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    config = own(tmp_path / "my.txt", RING)
    keep_layout(tmp_path, config, make_layout(config))
    copy = tmp_path / "config/layout.txt"
    assert copy.read_text() == RING
    # Ends of lines and of the file are no part of a layout.
    own(tmp_path / "my.txt", RING.replace("\n", "\r\n") + "\r\n")
    keep_layout(tmp_path, config, make_layout(config))
    own(tmp_path / "my.txt", OPEN)
    with pytest.raises(SettingsError) as refusal:
        keep_layout(tmp_path, config, make_layout(config))
    assert str(refusal.value) == (
        "resume must name a run whose layout is as it was when it began, got "
        f"'{tmp_path / 'my.txt'}', which was edited since ({copy} is a copy of what "
        "it was)"
    )
    assert copy.read_text() == RING


def test_a_damaged_copy_is_refused(tmp_path: Path) -> None:
    config = make_run(tmp_path).maze
    copy = tmp_path / "config/layout.txt"
    copy.write_bytes(RING.encode().replace(b" ", b"\xff", 1))
    layout = make_layout(config)
    for check in (
        lambda: keep_layout(tmp_path, config, layout),  # of a resume
        lambda: load_exploration(navigate_settings(tmp_path)),
    ):
        with pytest.raises(SettingsError) as refusal:
            check()
        assert str(refusal.value) == (
            f"a run folder must hold its layout as text, got the damaged {copy} "
            "('utf-8' codec can't decode byte 0xff in position 7: invalid start byte)"
        )


def test_of_other_mazes_and_worlds_nothing_is_kept(tmp_path: Path) -> None:
    maze = explore_settings("maze=maze1").maze
    keep_layout(tmp_path, maze, make_layout(maze))
    keep_layout(tmp_path, own(tmp_path / "my.txt", RING), None)
    assert not (tmp_path / "config").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recipe", "words", "later"),
    [
        ("explore", ["reward=random"], "training.save_exploration"),
        ("pretrain", [], "make_frame_buffer"),
    ],
)
def test_a_run_of_an_edited_layout_is_not_resumed(
    tmp_path: Path, recipe: str, words: list[str], later: str
) -> None:
    layout, run = tmp_path / "my.txt", tmp_path / "run"
    layout.write_text(RING)
    words += ["scale=smoke", "maze=file", f"maze.path={layout}"]
    script = importlib.import_module(f"recipes.{recipe}")

    def begin(*_: object) -> None:
        (run / "checkpoint.pt").touch()
        raise KeyboardInterrupt

    cut_off = patch(f"{script.__name__}.{later}", begin)
    done = run_forked(recipe, *words, f"hydra.run.dir={run}", inside=cut_off)
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    layout.write_text(OPEN)
    done = run_forked(recipe, f"resume={run}")
    assert done.returncode == 2, done.stderr
    sentence = f"{recipe}: resume must name a run whose layout is as it was when it"
    assert done.stderr.strip().splitlines()[-1].startswith(sentence)
    assert (run / "config/layout.txt").read_text() == RING
