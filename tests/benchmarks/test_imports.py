"""Every benchmark can be loaded: what it imports is still there."""

import pytest

from tests.benchmarks.loading import FOLDER, load_benchmark

#: What other benchmarks are made of; they cannot be run by themselves.
PARTS = (
    *("fault_files", "fault_kills", "fault_place", "fault_runs", "fault_together"),
    *("fuzz_beside", "fuzz_cases", "fuzz_damage", "fuzz_files", "fuzz_given"),
    *(
        "fuzz_layouts",
        "fuzz_maps",
        "fuzz_runs",
        "fuzz_settings",
        "made_by",
        "sanity_games",
    ),
    "sanity_tasks",
)
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


def test_the_benchmarks_are_found() -> None:
    assert {"coverage", "explore_speed"} <= set(SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_benchmark_imports(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert hasattr(load_benchmark(name, monkeypatch), "main") != (name in PARTS)
