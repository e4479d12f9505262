"""Benchmarks are scripts of a folder of their own: how a test gets hold of one."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).parent.parent.parent / "benchmarks"


def load_benchmark(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path, name = FOLDER / f"{name}.py", f"benchmark_{name}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # One benchmark may use another; a dataclass looks its own module up.
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module
