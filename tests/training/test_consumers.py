"""Which consumers a run has, and what they ask of a batch."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch

from tests.exploring import explore_settings, make_batch, world_of
from toponav.builders import make_networks
from toponav.envs import ENGINES
from toponav.methods import make_reward
from toponav.training import (
    ContinuedTraining,
    ExplorationState,
    finish,
    make_consumers,
    make_learner,
    needed_keys,
    trained_policies,
)

THRESHOLDS = {"reward_threshold": 0.5, "tc_threshold": 0.9, "tc_reach": 0.7}


def consumers_of(folder: Path, *overrides: str):
    config = explore_settings(*overrides)
    world, networks = world_of(config), None
    if config.reward.name == "novelty":
        networks = make_networks(config.model, world.spec)
        networks.modules.eval()
        networks.thresholds = dict(THRESHOLDS)
    state = ExplorationState()
    reward = make_reward(config, world, networks)
    learner = make_learner(config, world, reward, state, folder)
    _, consumers = make_consumers(
        config, world, networks, learner, reward, state, folder
    )
    return config, world, learner, consumers


@pytest.mark.parametrize(
    ("overrides", "names"),
    [
        ([], ["episodes", "learner", "best", "reward", "map", "locomotion"]),
        (
            ["online.learn=true", "engine=fake"],
            ["episodes", "learner", "best", "reward", "online", "map"],
        ),
        # An encoder of its own cannot learn from the TC-network's embeddings.
        (
            ["model.share_encoder=false"],
            ["episodes", "learner", "best", "reward", "map"],
        ),
        # Nothing needs the L-network where the map is made by poses.
        (["map.poses=true"], ["episodes", "learner", "best", "reward", "map"]),
        (
            ["map.poses=true", "locomotion.learn=true"],
            ["episodes", "learner", "best", "reward", "map", "locomotion"],
        ),
        (
            ["map.grow=false"],
            ["episodes", "learner", "best", "reward", "locomotion"],
        ),
        (
            ["map.grow=false", "locomotion.learn=false"],
            ["episodes", "learner", "best", "reward"],
        ),
        (["reward=coverage"], ["episodes", "learner", "best", "reward"]),
        # Rewards of different times do not compare: no policy is the best.
        (["reward=rnd"], ["episodes", "learner", "reward"]),
        (["reward=random"], ["episodes", "learner", "reward"]),
    ],
)
def test_what_is_off_is_not_in_the_list(
    overrides: list[str],
    names: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    assert list(consumers_of(tmp_path, *overrides)[-1]) == names


def test_all_can_learn_from_a_batch_with_the_keys_they_ask_for(tmp_path: Path) -> None:
    config, _, _, consumers = consumers_of(tmp_path, "map.grow=false")
    batch = make_batch(config)
    batch["collector", "traj_ids"] = torch.zeros(4, 32, dtype=torch.int64)
    batch["step_count"] = torch.arange(32).expand(4, 32).unsqueeze(-1).clone()
    batch = batch.select(*needed_keys(consumers), "env_id", "version")
    for consumer in consumers.values():
        consumer.extend(batch)
    policies = trained_policies(
        config, world_of(config), consumers["learner"], consumers
    )
    assert list(policies) == ["best", "last"]


def test_no_consumer_but_log_and_map_asks_for_the_truth(tmp_path: Path) -> None:
    _, _, _, consumers = consumers_of(tmp_path)
    for name, consumer in consumers.items():
        asks = any("privileged" in key for key in consumer.in_keys)
        assert asks == (name in ("episodes", "map")), name


def test_what_changes_explorers_is_finished_before_they_are_evaluated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    *_, consumers = consumers_of(tmp_path)
    consumers["online"] = ContinuedTraining.__new__(ContinuedTraining)
    finished: list[str] = []

    def half_way(_: Path, progress: Callable[[float], object], name: str) -> None:
        progress(0.5)
        finished.append(name)

    for name, one in consumers.items():
        monkeypatch.setattr(one, "finish", partial(half_way, name=name))
    finish(consumers, tmp_path, beside=False)
    assert finished == ["episodes", "learner", "best", "reward", "online"]
    shares: list[float] = []
    finish(consumers, tmp_path, beside=True, progress=shares.append)
    assert finished[5:] == ["map", "locomotion"]
    # Half of the first, half of the second, and all.
    assert shares == [0.25, 0.75, 1.0]
