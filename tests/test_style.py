"""The linters and the type checker pass, with the settings of pyproject.toml."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def passes(*command: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff_finds_nothing() -> None:
    passes("ruff", "check")


def test_ruff_would_format_nothing_otherwise() -> None:
    passes("ruff", "format", "--check")


@pytest.mark.slow
def test_types_are_sound() -> None:
    passes("mypy")
