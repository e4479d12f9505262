"""A collector goes on where another one was, on an engine without processes."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase

from tests.collectors import test_mailbox_collector
from tests.envs import fake_engine
from tests.exploring import explore_settings, world_of
from tests.test_explore import require_same
from toponav.builders import make_networks
from toponav.collectors import Mailbox, MailboxCollector, PreparedCollector
from toponav.config import ExploreConfig
from toponav.envs import ENGINES
from toponav.methods import LEARNERS, make_reward
from toponav.training import (
    ExplorationState,
    Explorer,
    make_consumers,
    make_learner,
    make_worker_env,
    make_worker_policy,
    prepare_worker,
    publish,
    restore_exploration,
    save_exploration,
)

SMALL = ("engine=fake", "maze=maze1", "policy.view_size=36", "loss.rollout=16")
#: Settings with everything that has a state of its own.
RUNS = [
    ("reward.threshold=0.5", "collect.noisy_tv=true"),
    ("reward.threshold=0.5", "policy.input=pixels", "online.learn=true"),
    ("reward=rnd",),
    ("reward=icm",),
    ("reward=vime",),
    ("reward=ex2",),
    ("reward=random",),
]


@pytest.fixture(autouse=True)
def registered_fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    yield
    fake_engine.GAMES.clear()


def make_explorer(config: ExploreConfig) -> Explorer:
    torch.manual_seed(0)
    world, networks = world_of(config), None
    if config.reward.name == "novelty":
        networks = make_networks(config.model, world.spec)
    policy = LEARNERS[config.loss.name].make_policy(config, world)
    return Explorer(policy, make_reward(config, world, networks), networks)


def make_collector(
    config: ExploreConfig, mailbox: Mailbox, **given: Any
) -> MailboxCollector:
    world = world_of(config)
    episodes: Sequence[Mapping[str, Any]] = given.pop("episodes", None) or [None]
    prepare = partial(
        prepare_worker,
        settings=config,
        world=world,
        mailbox=mailbox,
        **{"decisions": 0, "keep": None, **given},
    )
    return PreparedCollector(
        make_worker_env,
        prepare=prepare,
        worker_idx=0,
        episodes=episodes[0],
        policy_factory=lambda: make_worker_policy(config, world),
        frames_per_batch=config.collect.envs * config.loss.rollout,
        use_buffers=True,
        return_same_td=True,
        auto_register_policy_transforms=False,
    )


def batches(collector: MailboxCollector, number: int) -> list[TensorDictBase]:
    return [collector.rollout().clone() for _ in range(number)]


@pytest.mark.parametrize(
    "overrides",
    [*RUNS[:3], *(pytest.param(one, marks=pytest.mark.slow) for one in RUNS[3:])],
)
def test_a_collector_goes_on_where_another_one_was(overrides: tuple[str, ...]) -> None:
    config = explore_settings(*SMALL, *overrides)
    explorer = make_explorer(config)
    mailbox = Mailbox(explorer.modules())
    whole = make_collector(config, mailbox)
    # Not a multiple of an episode's 64 decisions, after the first cuts.
    batches(whole, 5)
    state = copy.deepcopy(whole.running_episodes())
    for name, module in explorer.modules().items():
        for value in module.state_dict().values():
            value.copy_(1.1 * value)
        if name != "networks" or config.online.learn:
            mailbox.publish(name, module)
    expected = batches(whole, 4)
    whole.shutdown()
    # A process of its own would have other seeds, and other random numbers so far.
    resumed = make_collector(config, mailbox, decisions=1, episodes=[state])
    found = batches(resumed, 4)
    resumed.shutdown()
    assert sum(int(batch["next", "done"].sum()) for batch in expected) >= 4
    for one, other in zip(expected, found, strict=True):
        assert set(one.keys(True, True)) == set(other.keys(True, True))
        for key in one.keys(True, True):
            assert torch.equal(one[key], other[key]), key


def explore(
    config: ExploreConfig, folder: Path, *, decisions: int
) -> dict[str, object]:
    """The loop of the recipe in this process: go on up to so many decisions, save."""
    folder.mkdir(exist_ok=True)
    torch.manual_seed(config.seed)
    world, state = world_of(config), ExplorationState()
    reward = make_reward(config, world, None)
    learner = make_learner(config, world, reward, state, folder)
    explorer = Explorer(learner.policy, reward, None)
    _, consumers = make_consumers(config, world, None, learner, reward, state, folder)
    episodes = restore_exploration(folder, state, consumers)
    mailbox = Mailbox(explorer.modules(), versions=state.versions)
    given = {"decisions": state.decisions, "episodes": episodes}
    collector = make_collector(config, mailbox, **given)
    while state.decisions < decisions:
        (batch,) = batches(collector, 1)
        state.count(batch.numel(), 0.0, config.collect)
        for consumer in consumers.values():
            consumer.extend(batch)
        state.versions |= publish(mailbox, explorer, consumers.values())
    running = collector.running_episodes()
    assert running is not None
    save_exploration(folder, state, consumers, [running])
    collector.shutdown()
    found: dict[str, object] = torch.load(folder / "checkpoint.pt", weights_only=True)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("reward=rnd", "reward.feature_dim=16"),
        # What they keep has come round before the cut, and after it does so again.
        ("reward=vime", "reward.hidden=4", "reward.capacity=100"),
        ("reward=ex2", "reward.keep_fraction=1", "reward.capacity=100"),
    ],
)
def test_a_run_whose_reward_learns_ends_as_if_it_had_not_been_cut(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    config = explore_settings(*SMALL, *words, "collect.decisions=512")
    # Batches of 4 times 16 decisions; cut after the third, within an episode of 64.
    whole = explore(config, tmp_path / "whole", decisions=320)
    for decisions in (192, 320):
        cut = explore(config, tmp_path / "cut", decisions=decisions)
    require_same(whole, cut)


def test_what_is_kept_holds_no_weights() -> None:
    config = explore_settings(*SMALL, "reward=rnd")
    collector = make_collector(config, Mailbox(make_explorer(config).modules()))
    kept = collector.running_episodes()
    collector.shutdown()
    assert kept is not None
    assert not [name for name in kept["transforms"] if name.endswith("weight")]


def test_an_environment_that_cannot_play_again_has_nothing_to_keep() -> None:
    collector = test_mailbox_collector.make_collector(
        test_mailbox_collector.make_mailbox()
    )
    assert collector.running_episodes() is None
    collector.shutdown()
