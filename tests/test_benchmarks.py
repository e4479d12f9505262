"""Every benchmark can be loaded: what it imports is still there."""

import importlib.util
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "benchmarks"
SCRIPTS = sorted(FOLDER.glob("*.py"))
#: What other benchmarks are made of; they cannot be run by themselves.
PARTS = ("sanity_games", "sanity_tasks")


def test_the_benchmarks_are_found() -> None:
    assert {"coverage", "explore_speed"} <= {path.stem for path in SCRIPTS}


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_benchmark_imports(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"benchmark_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # One benchmark may use another; a dataclass looks its own module up.
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    assert hasattr(module, "main") != (path.stem in PARTS)
