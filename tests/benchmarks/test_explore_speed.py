"""The speed of exploring against the roof of what it runs on."""

import os
import time

import pytest

from tests.benchmarks.loading import load_benchmark
from tests.stand_in_device import NAME
from tests.stand_in_workers import stand_in_workers
from toponav.methods import make_world


def test_a_roof_is_that_of_what_is_full_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speed = load_benchmark("explore_speed", monkeypatch)
    parts = {
        "engines": {"core": 0.002},
        "embed": {"core": 0.0001, "kernels": 0.0002, "copies": 0.0001},
        "learn": {"core": 0.0003, "kernels": 0.0005, "copies": 0.0},
    }
    # Two cores: 0.0024 / 2 = 0.0012 s, 833 decisions/s; the learner's: 3,333; the
    # GPU: 0.0007 s of kernels, 1,429, and 10,000 of copies.
    found = speed.against_roof(parts, 500.0, cores=2)
    assert found["roofs"] == pytest.approx(
        {"cores": 1 / 0.0012, "learner": 1 / 0.0003, "kernels": 1 / 0.0007}
        | {"copies": 1 / 0.0001}
    )
    assert found["full_first"] == "cores"
    assert found["roof"] == pytest.approx(833.33, rel=1e-4)
    assert found["ratio"] == pytest.approx(0.6)
    # 500 decisions/s of 0.002, 0.0001 and 0.0003 s, on two cores.
    shares = {"engines": 0.5, "embed": 0.025, "learn": 0.075, "rest": 0.4}
    assert found["shares"] == pytest.approx(shares)
    assert found["milliseconds_of_the_gpu"] == {
        "kernels": pytest.approx({"embed": 0.2, "learn": 0.5}),
        "copies": pytest.approx({"embed": 0.1}),
    }
    # Eight cores would do 3,333, more than the GPU's kernels.
    assert speed.against_roof(parts, 500.0, cores=8)["full_first"] == "kernels"
    # Without a GPU, and with cores enough, the learner is full first: it is one thread.
    parts = {name: {"core": part["core"]} for name, part in parts.items()}
    found = speed.against_roof(parts, 500.0, cores=16)
    assert found["full_first"] == "learner"
    assert found["roofs"].keys() == {"cores", "learner"}
    assert not found["milliseconds_of_the_gpu"]


def test_engines_are_timed_with_their_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speed = load_benchmark("explore_speed", monkeypatch)
    settings = speed.make_settings("laptop", ["collect.envs=4", "collect.workers=1"])
    began = time.perf_counter()
    seconds = speed.time_env(make_world(settings), envs=4, steps=50)
    spent = time.perf_counter() - began
    # Each of 50 steps draws four views; no more than all cores can have done it.
    assert 0 < 50 * 4 * seconds <= spent * len(os.sched_getaffinity(0))


@pytest.mark.slow
def test_parts_are_timed_where_they_are_computed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speed = load_benchmark("explore_speed", monkeypatch)
    small = ("collect.envs=2", "collect.workers=1", "loss.rollout=40")
    small += ("loss.minibatches=2", "model.embedding_dim=8", "policy.hidden=16")
    with stand_in_workers():
        settings = speed.make_settings("laptop", [f"device={NAME}", *small])
        found = speed.measure(settings, 0.1)
    # Views are copied to the device; nothing but a GPU has kernels that are counted.
    names = {"engines", "policy", "embed", "compare", "transfer", "learn"}
    assert found["parts"].keys() == names
    assert min(found["mean"], *(one["core"] for one in found["parts"].values())) > 0
    assert all(one.keys() == {"core"} for one in found["parts"].values())
