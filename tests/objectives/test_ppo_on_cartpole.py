"""`RecurrentPPOLoss` with the package's policy on a task of Gymnasium."""

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, TransformedEnv

from tests.objectives.test_a3c_on_cartpole import LOSSES, make_env, mean_return
from toponav.keys import SCALED_REWARD
from toponav.modules import ActorCritic
from toponav.objectives import RecurrentPPOLoss, ReturnScale, SequenceMinibatches
from toponav.transforms import make_policy_inputs

ENVS, STEPS = 16, 80


def make_policy(seed: int) -> ActorCritic:
    """One that reads CartPole's four numbers where it usually reads an embedding."""
    torch.manual_seed(seed)
    return ActorCritic(
        num_actions=2,
        embedding_dim=4,
        view_key="observation",
        code_dim=64,
        hidden_dim=64,
        one_hot=True,
    )


def make_task(policy: ActorCritic, seed: int) -> EnvBase:
    env = make_env(ENVS, categorical=False)
    inputs = make_policy_inputs(policy, reward="reward")
    env = TransformedEnv(env, Compose(*inputs))
    env.set_seed(seed)
    return env


def learn(
    env: EnvBase, policy: ActorCritic, *, batches: int, seed: int, is_scaled: bool
) -> None:
    loss = RecurrentPPOLoss(policy)
    loss.make_value_estimator(gamma=0.99, lmbda=0.95)
    scale = ReturnScale(ENVS, reward="reward", enabled=is_scaled)
    loss.set_keys(reward=SCALED_REWARD)
    cut = SequenceMinibatches(20, num_minibatches=4, seed=seed)
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3, eps=1e-5)
    size = ENVS * STEPS
    collector = Collector(
        env, policy, frames_per_batch=size, total_frames=batches * size
    )
    for batch in collector:
        loss.estimate_advantage(scale(batch))
        for part in (part for _ in range(4) for part in cut(batch)):
            out = loss(part)
            optimizer.zero_grad()
            sum(out[key] for key in LOSSES).backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()
    collector.shutdown(close_env=False)


@pytest.mark.slow
def test_it_learns_cartpole() -> None:
    policy = make_policy(0)
    env = make_task(policy, 0)
    assert mean_return(env, policy) < 30
    learn(env, policy, batches=20, seed=0, is_scaled=True)
    assert mean_return(env, policy) > 60
