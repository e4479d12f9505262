from pathlib import Path

import pytest

from toponav.config import SettingsError
from toponav.launch import resumed_arguments


def run_folder(tmp_path: Path, *overrides: str) -> Path:
    folder = tmp_path / "maze=select,seed=0"
    (folder / "config").mkdir(parents=True)
    lines = "".join(f"- {word}\n" for word in overrides) or "[]\n"
    (folder / "config/overrides.yaml").write_text(lines)
    return folder


def test_a_resumed_run_gets_its_own_command_line_and_folder(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, "maze=maze1", "seed=3", "resume=elsewhere")
    assert resumed_arguments([f"resume={folder}", "train.updates=9"]) == [
        "maze=maze1",
        "seed=3",
        "train.updates=9",
        f"resume='{folder}'",
        f"hydra.run.dir='{folder}'",
    ]


@pytest.mark.parametrize("given", ["'{}'", '"{}"', "{}"])
def test_quotes_around_the_folder_do_not_matter(tmp_path: Path, given: str) -> None:
    folder = run_folder(tmp_path)
    found = resumed_arguments([f"resume={given.format(folder)}"])
    assert found[-1] == f"hydra.run.dir='{folder}'"


@pytest.mark.parametrize("arguments", [[], ["maze=maze1"], ["resume=null"]])
def test_other_command_lines_stay_as_they_are(arguments: list[str]) -> None:
    assert resumed_arguments(arguments) == arguments


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="resume must name the folder of a run"):
        resumed_arguments([f"resume={tmp_path}"])
