"""The speed of exploring against the roof of what it runs on."""

import pytest
import torch

from tests.benchmarks.loading import load_benchmark
from tests.stand_in_device import NAME
from tests.stand_in_workers import stand_in_workers


def test_a_roof_is_that_of_cores_or_of_the_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speed = load_benchmark("explore_speed", monkeypatch)
    here, there = torch.device("cpu"), torch.device("cuda")
    parts = {"engines": 0.002, "embed": 0.0001, "learn": 0.0003}
    places = {"engines": here, "embed": there, "learn": there}
    # Two cores: 0.002 / 2 = 0.001 s, 1,000 decisions/s; the device: 0.0004 s, 2,500.
    found = speed.against_roof(parts, places, 500.0, cores=2)
    assert found["roof"] == pytest.approx(1000)
    assert found["ratio"] == pytest.approx(0.5)
    assert found["shares"] == pytest.approx({"engines": 0.5, "rest": 0.5})
    # 500 decisions/s of 0.0001 and 0.0003 s.
    assert found["shares_elsewhere"] == pytest.approx({"embed": 0.05, "learn": 0.15})
    # Eight cores: 4,000 decisions/s, so that the device is full first.
    found = speed.against_roof(parts, places, 500.0, cores=8)
    assert found["roof"] == pytest.approx(2500)
    # All of it on two cores: 2 / 0.0024.
    found = speed.against_roof(parts, dict.fromkeys(parts, here), 500.0, cores=2)
    assert found["roof"] == pytest.approx(833.33, rel=1e-4)
    assert not found["milliseconds_elsewhere"]


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
        places = speed.places_of(settings)
    assert found["parts"].keys() == places.keys()
    assert min(found["mean"], *found["parts"].values()) > 0
    here = [name for name, place in places.items() if str(place) == "cpu"]
    assert here == ["engines"]
