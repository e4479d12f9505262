"""Watching engine processes."""

from collections.abc import Callable
from pathlib import Path

import psutil
import pytest


@pytest.fixture
def alive() -> Callable[[int], bool]:
    """Whether a process runs; a zombie does not."""

    def alive(pid: int) -> bool:
        try:
            return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False

    return alive


@pytest.fixture
def registered(private_folders: Path) -> Callable[[], list[Path]]:
    """The folders of all engines of this test session."""

    def registered() -> list[Path]:
        return [path.parent for path in private_folders.rglob("engine.ini")]

    return registered
