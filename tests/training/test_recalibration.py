"""Thresholds of networks that continue training."""

import copy
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from tests.cut_walks import one_start, two_rooms
from tests.envs import fake_engine
from tests.exploring import explore_settings, world_of
from tests.models import tiny_model
from tests.training.pair_storage import WORLD, make_walks, pair_settings
from tests.training.test_continued_training import CONFIG
from toponav.builders import Networks, make_networks
from toponav.data import HeldOut
from toponav.envs import ENGINES
from toponav.graph import WalkWaypoints
from toponav.keys import NETWORK_PIXELS
from toponav.methods import make_reward
from toponav.training import ContinuedTraining, Explorer, make_consumers, make_learner
from toponav.training.checkpoints import (
    ExplorationState,
    restore_exploration,
    save_exploration,
)
from toponav.training.recalibration import Recalibration, walk_for_calibration


def views() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    noise = torch.randint(0, 40, (2, 40, 8, 12, 3), generator=generator)
    seen = make_walks(episodes=2, length=40)[NETWORK_PIXELS] // 2
    return seen + noise.to(torch.uint8)


def networks_of(seed: int = 0) -> Networks:
    torch.manual_seed(seed)
    networks = make_networks(tiny_model(), WORLD)
    networks.modules.eval()
    found = share_of(networks)
    # Thresholds at which something is new and something is not.
    networks.thresholds = {
        "tc_threshold": max(found(0.7), 0.01),
        "reward_threshold": max(found(0.3), 0.01),
        "tc_reach": 0.01,
    }
    return networks


def share_of(networks: Networks):
    """The threshold below which a share of all similarities lies."""
    walk = walked(networks)[0].later
    seen = torch.as_tensor(walk[walk >= 0])
    return lambda share: float(seen.quantile(share))


def walked(networks: Networks) -> list[WalkWaypoints]:
    with torch.no_grad():
        return [WalkWaypoints(networks.tc.embed(one), networks.tc) for one in views()]


def mean_share(networks: Networks, name: str) -> float:
    walks = walked(networks)
    return sum(one.share(networks.thresholds[name]) for one in walks) / len(walks)


def recalibration(networks: Networks) -> Recalibration:
    frames = TensorDict({NETWORK_PIXELS: views()}, [2, 40])
    walks = HeldOut(frames, name="maze1")
    return Recalibration(walks, networks, k=2, autocast=nullcontext())


def test_the_same_walks_keep_as_many_waypoints_by_new_weights() -> None:
    networks = networks_of()
    before = {name: mean_share(networks, name) for name in networks.thresholds}
    calibrate = recalibration(networks)
    assert calibrate.shares["tc_threshold"] == pytest.approx(before["tc_threshold"])
    other = networks_of(seed=3)
    found = calibrate(other, networks.thresholds)
    other.thresholds = dict(networks.thresholds)
    stale = mean_share(other, "tc_threshold")
    other.thresholds = found
    for name in ("tc_threshold", "reward_threshold"):
        assert mean_share(other, name) == pytest.approx(before[name], abs=0.02), name
    assert abs(stale - before["tc_threshold"]) > 0.04
    assert found["tc_reach"] <= found["tc_threshold"]


def test_thresholds_that_still_fit_stay() -> None:
    networks = networks_of()
    found = recalibration(networks)(networks, networks.thresholds)
    for name in ("tc_threshold", "reward_threshold"):
        assert found[name] == networks.thresholds[name]


def test_episodes_that_end_within_a_walk_are_apart() -> None:
    old = {"tc_threshold": 0.731, "reward_threshold": 0.5, "tc_reach": 0.55}

    def calibrated(walks: HeldOut, tc: Any) -> tuple[dict[str, float], float]:
        networks: Any = SimpleNamespace(tc=tc, thresholds=old, device="cpu")
        found = Recalibration(walks, networks, k=3, autocast=nullcontext())
        return found.shares, found(networks, old)["tc_reach"]

    shares, _ = calibrated(*one_start())
    # The map has 3 waypoints of 200 views. The reward's memory has 2 in two episodes,
    # beside the 20 that begin one, of which the first counts: 1 + 2.
    assert shares == {"tc_threshold": 3 / 200, "reward_threshold": 3 / 200}
    # Over the ends of 4 views each, a tenth of the close pairs would lie below 0.52.
    assert calibrated(*two_rooms())[1] == pytest.approx(0.6)


def test_networks_without_thresholds_get_none() -> None:
    networks = networks_of()
    networks.thresholds = {}
    assert recalibration(networks)(networks, {}) == {}


@pytest.fixture
def registered_fake(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    yield
    fake_engine.GAMES.clear()


SMALL = ("engine=fake", "maze=maze1", "policy.view_size=36", "online.learn=true")


def run_of(folder: Path, *overrides: str, seed: int = 0):
    """All that a run has, on an engine without processes."""
    settings = explore_settings(*SMALL, *overrides)
    settings = replace(settings, online=CONFIG, pairs=pair_settings())
    world = world_of(settings)
    torch.manual_seed(seed)
    networks = make_networks(settings.model, world.spec)
    networks.modules.eval()
    networks.thresholds = {
        "tc_threshold": 0.5,
        "reward_threshold": 0.5,
        "tc_reach": 0.4,
    }
    state = ExplorationState()
    reward = make_reward(settings, world, networks)
    learner = make_learner(settings, world, reward, state, folder)
    _, consumers = make_consumers(
        settings, world, networks, learner, reward, state, folder
    )
    return networks, Explorer(learner.policy, reward, networks), state, consumers


def move_weights(networks: Networks) -> None:
    with torch.no_grad():
        for parameter in networks.modules.parameters():
            parameter.mul_(1.1).add_(0.01)


def online_of(consumers) -> ContinuedTraining:
    online = consumers["online"]
    assert isinstance(online, ContinuedTraining)
    return online


@pytest.mark.usefixtures("registered_fake")
def test_a_version_brings_its_thresholds_to_reward_and_map(tmp_path: Path) -> None:
    networks, explorer, _, consumers = run_of(tmp_path)
    online, growth = online_of(consumers), consumers["map"]
    move_weights(online.trained)
    online.recalibrate = lambda trained, old: {
        "tc_threshold": 0.75,
        "reward_threshold": 0.25,
        "tc_reach": 0.625,
    }
    online._hand_over()
    assert networks.thresholds["tc_threshold"] == 0.75
    assert float(explorer.modules()["networks"].threshold) == 0.25
    growth.refresh({"networks": 1})
    assert growth.map.rules.tc_threshold == 0.75
    assert growth.map.rules.tc_reach == 0.625


@pytest.mark.usefixtures("registered_fake")
def test_a_number_stays_whatever_is_calibrated(tmp_path: Path) -> None:
    numbers = "reward.threshold=0.3", "map.tc_threshold=0.8", "map.tc_reach=0.7"
    _, explorer, _, consumers = run_of(tmp_path, *numbers)
    online, growth = online_of(consumers), consumers["map"]
    move_weights(online.trained)
    online._hand_over()
    growth.refresh({"networks": 1})
    assert float(explorer.modules()["networks"].threshold) == 0.3
    rules = growth.map.rules
    assert (rules.tc_threshold, rules.tc_reach) == (0.8, 0.7)


@pytest.mark.usefixtures("registered_fake")
def test_a_resumed_run_has_the_weights_and_thresholds_that_it_had(
    tmp_path: Path,
) -> None:
    networks, explorer, state, consumers = run_of(tmp_path)
    move_weights(online_of(consumers).trained)
    shares = {"tc_threshold": 0.3, "reward_threshold": 0.1}
    online_of(consumers).recalibrate.shares = shares
    online_of(consumers)._hand_over()
    assert networks.thresholds["tc_threshold"] != 0.5
    growth = consumers["map"]
    growth.refresh({"networks": 1})
    save_exploration(tmp_path, state, consumers)
    kept = copy.deepcopy((networks.thresholds, networks.tc.state_dict()))

    again, other, state, resumed = run_of(tmp_path, seed=1)
    restore_exploration(tmp_path, state, resumed)
    assert again.thresholds == kept[0]
    assert online_of(resumed).recalibrate.shares == shares
    threshold = explorer.modules()["networks"].threshold
    assert torch.equal(other.modules()["networks"].threshold, threshold)
    # The map embeds by the restored weights, not by those of the start.
    for name, weight in resumed["map"].tc.state_dict().items():
        assert torch.equal(weight, kept[1][name]), name
    assert resumed["map"].map.rules == growth.map.rules


@pytest.mark.usefixtures("registered_fake")
def test_a_run_that_resumes_sees_the_same_walks() -> None:
    settings = explore_settings(*SMALL)
    world = world_of(settings)
    one, other = (walk_for_calibration(settings, world) for _ in range(2))
    assert (one.num_walks, one.length) == (6, 64)
    assert torch.equal(one.pixels, other.pixels)
    assert one.episodes.length.tolist() == [64] * 6
