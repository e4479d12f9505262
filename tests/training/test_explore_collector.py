"""A collecting process's collector, built in this process."""

from functools import partial

import pytest
import torch

from tests import foreign_world  # noqa: F401
from tests.exploring import explore_settings, world_of
from toponav.builders import make_networks
from toponav.collectors import Mailbox, PreparedCollector
from toponav.config import SettingsError
from toponav.keys import EMBEDDING, NETWORK_PIXELS
from toponav.methods import LEARNERS, make_reward
from toponav.training import (
    Explorer,
    make_explore_collector,
    make_worker_env,
    prepare_worker,
)
from toponav.transforms import WaypointMemory

WORLD = ("world=gym", "world.id=tests.foreign_world:ForeignWorld-v0")


@pytest.mark.parametrize("rollouts", [0, 1])
def test_a_new_version_embeds_the_first_views_too(rollouts: int) -> None:
    """Also one that is published after the collector was built, before it plays."""
    settings = explore_settings(*WORLD, "online.learn=true", "reward.threshold=0.5")
    world = world_of(settings)
    networks = make_networks(settings.model, world.spec)
    networks.modules.eval()
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    explorer = Explorer(policy, make_reward(settings, world, networks), networks)
    mailbox = Mailbox(explorer.modules())
    prepare = partial(
        prepare_worker,
        settings=settings,
        world=world,
        mailbox=mailbox,
        keep=[EMBEDDING, NETWORK_PIXELS],
        decisions=0,
    )
    collector = PreparedCollector(
        make_worker_env,
        prepare=prepare,
        worker_idx=0,
        policy=LEARNERS[settings.loss.name].make_policy(settings, world),
        frames_per_batch=2 * settings.loss.rollout,
        total_frames=-1,
    )
    try:
        for _ in range(rollouts):
            collector.rollout()
        explorer.novelty.threshold.fill_(0.75)
        with torch.no_grad():
            for parameter in networks.tc.encoder.parameters():
                parameter += 0.1 * torch.randn_like(parameter)
        mailbox.publish("networks", explorer.modules()["networks"])
        batch = collector.rollout()
        transforms = [*collector.env.transform]
    finally:
        collector.shutdown()
    assert batch["version", "networks"].unique().tolist() == [1]
    (memory,) = [one for one in transforms if isinstance(one, WaypointMemory)]
    assert memory.threshold == 0.75
    with torch.no_grad():
        expected = networks.tc.embed(batch[NETWORK_PIXELS].flatten(0, 1))
    torch.testing.assert_close(batch[EMBEDDING].flatten(0, 1), expected)


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ("collect.workers=4", "collect.workers must stay 2"),
        ("collect.envs=6", "collect.envs must stay 4"),
    ],
)
def test_episodes_go_on_where_they_were(given: str, rule: str) -> None:
    """Of two processes with two mazes each; nothing was started when it is said."""
    words = ("collect.mode=sync", "collect.workers=2", "collect.envs=4", given)
    settings = explore_settings(*WORLD, *words, "reward=random")
    episodes = [{"games": {"begun": [1, 1]}}] * 2
    with pytest.raises(SettingsError, match=rf"^{rule} where episodes are resumed"):
        make_explore_collector(
            settings, world_of(settings), Mailbox({}), keep=[], episodes=episodes
        )
