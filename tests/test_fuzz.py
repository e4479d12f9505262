"""Some of the cases of benchmarks/fuzz.py: one sentence each, and none hangs."""

import random
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

from tests.benchmarks.loading import load_benchmark


@pytest.fixture(scope="module")
def fuzz() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        module = load_benchmark("fuzz", patch)
        module.prepare()
        yield module


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number"), [("layout", 140), ("settings", 8), ("file", 70)]
)
def test_bad_input_is_one_sentence(fuzz: ModuleType, kind: str, number: int) -> None:
    kinds = [make.__name__ for make in fuzz.MAKERS]
    first = kinds.index(f"{kind}_case")
    found = fuzz.run_cases(range(first, number * len(kinds), len(kinds)))
    assert found["faults"] == []
    assert found["total"]["refused"] > number / 2


def test_a_case_that_raises_or_hangs_is_a_fault(
    fuzz: ModuleType, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def case(run) -> str:
        return fuzz.outcome(fuzz.Case(0, "layout", "", run), tmp_path)[0]

    monkeypatch.setattr(fuzz, "LIMIT_S", 0.2)
    cases = load_benchmark("fuzz_cases", monkeypatch)
    assert fuzz.is_refusal("tour: seed must be at least 0, got -1\n")
    # A name without a sentence says nothing.
    assert not fuzz.is_refusal("tour: \n")
    assert case(lambda: fuzz.time.sleep(60)) == "hang"
    assert case(lambda: 1 / 0) == "traceback"
    assert case(lambda: cases.require_same(False)) == "changed"
    assert case(lambda: random.random()) == "accepted"
    assert case(lambda: refuse(fuzz)) == "refused"
    assert case(lambda: (tmp_path / "left").touch() or refuse(fuzz)) == "litter"


def refuse(fuzz: ModuleType) -> None:
    raise fuzz.SettingsError("tour: seed must be at least 0, got -1")


def test_of_a_sweep_each_job_that_is_refused_says_so(fuzz: ModuleType) -> None:
    last = "tour: not all jobs of the sweep succeeded"
    assert fuzz.is_refusal(f"tour: no (seed=-1)\n{last}")
    assert not fuzz.is_refusal(f"tour: no\n{last}")


def test_recipes_that_start_from_runs_get_them(
    fuzz: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = load_benchmark("fuzz_cases", monkeypatch)
    settings = fuzz.importlib.import_module("fuzz_settings")
    for recipe in settings.OWN:
        folder = tmp_path / recipe
        folder.mkdir()
        line = ["scale=smoke", settings.start_of(recipe, folder)]
        found = cases.Case(0, "", "", partial(settings.run_recipe, recipe, line))
        assert fuzz.outcome(found, folder)[0] == "accepted"
