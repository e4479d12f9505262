"""Both losses learn a task that needs a memory, and the random policy does not."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.envs.utils import check_env_specs

from tests.objectives.cue_corridor import make_env, make_network
from toponav.modules import ActorCritic
from toponav.objectives import (
    A3CLoss,
    RecurrentPPOLoss,
    SequenceMinibatches,
    SharedRMSProp,
)

NUM_ENVS = 32
SLICE = 12
Update = Callable[[TensorDictBase], None]


def descend(losses: TensorDictBase, optimizer: torch.optim.Optimizer) -> None:
    loss = sum(v for key, v in losses.items() if key.startswith("loss_"))
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def a3c_update(network: ActorCritic) -> Update:
    loss = A3CLoss(network).make_value_estimator(gamma=0.9)
    optimizer = SharedRMSProp(network.parameters(), lr=0.01, eps=0.001)
    return lambda batch: descend(loss(batch), optimizer)


def ppo_update(network: ActorCritic) -> Update:
    loss = RecurrentPPOLoss(network).make_value_estimator(gamma=0.9)
    optimizer = torch.optim.Adam(network.parameters(), lr=0.003)
    minibatches = SequenceMinibatches(SLICE, num_minibatches=2, seed=0)

    def update(batch: TensorDictBase) -> None:
        batch = loss.estimate_advantage(batch)
        for _ in range(3):
            for minibatch in minibatches(batch):
                descend(loss(minibatch), optimizer)

    return update


def train(network: ActorCritic, update: Update, num_updates: int) -> None:
    collector = Collector(
        make_env(network, NUM_ENVS),
        network,
        frames_per_batch=NUM_ENVS * SLICE,
        total_frames=NUM_ENVS * SLICE * num_updates,
        auto_register_policy_transforms=False,
    )
    for batch in collector:
        update(batch)
    collector.shutdown()


class Forgetful(TensorDictModuleBase):
    """The network, with an episode's start at every decision."""

    def __init__(self, network: ActorCritic) -> None:
        super().__init__()
        self.network = network
        self.in_keys, self.out_keys = network.in_keys, network.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        decision = tensordict.copy()
        decision["is_init"] = torch.ones_like(decision["is_init"])
        results: TensorDictBase = self.network(decision).select(*self.out_keys)
        return tensordict.update(results)


def mean_return(network: ActorCritic, policy: TensorDictModuleBase) -> float:
    """Mean return of about 1,000 sampled episodes, which pay at their ends only."""
    torch.manual_seed(1)
    with torch.no_grad():
        env = make_env(network, 64, seed=1)
        following = env.rollout(60, policy, break_when_any_done=False)["next"]
    return float(following["reward"].sum() / following["done"].sum())


def test_the_corridor_keeps_its_specs() -> None:
    check_env_specs(make_env(make_network(), 3), break_when_any_done="both")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make_update", "num_updates"), [(a3c_update, 80), (ppo_update, 24)]
)
def test_a_loss_learns_to_remember(
    make_update: Callable[[ActorCritic], Update], num_updates: int
) -> None:
    network = make_network()
    # About 1,000 returns of 1 or -1 around 0: 0.13 is four standard errors.
    assert abs(mean_return(network, network)) < 0.13
    train(network, make_update(network), num_updates)
    assert mean_return(network, network) > 0.8
    # What it learned is in the memory: without it the signs are guessed again.
    assert abs(mean_return(network, Forgetful(network))) < 0.13
