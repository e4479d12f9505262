"""What comes with the package, whichever way it is installed."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = """
from setuptools import build_meta
build_meta.build_sdist("out")
build_meta.build_wheel("out")
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    house = tmp_path_factory.mktemp("built")
    unwanted = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "toponav", house / "toponav", ignore=unwanted)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, house)
    command = [sys.executable, "-c", BUILD]
    done = subprocess.run(command, cwd=house, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return house / "out"


def test_wheel_and_sdist_have_every_file_of_the_package(built: Path) -> None:
    files = {
        str(file.relative_to(ROOT))
        for file in (ROOT / "toponav").rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert "toponav/builders/package_networks/maze3.pt" in files
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        assert files - set(wheel.namelist()) == set()
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        names = {name.split("/", 1)[-1] for name in sdist.getnames()}
        assert files - names == set()
