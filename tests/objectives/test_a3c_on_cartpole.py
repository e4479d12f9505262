"""The A3C loss with a plain actor and critic of TorchRL on a task of Gymnasium."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, GymEnv, SerialEnv
from torchrl.envs.utils import RandomPolicy
from torchrl.modules import MLP, OneHotCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ValueEstimators

from toponav.objectives import A3CLoss

LOSSES = ("loss_objective", "loss_critic", "loss_entropy")


def make_env(num_envs: int, *, categorical: bool) -> EnvBase:
    env = SerialEnv(
        num_envs,
        lambda: GymEnv("CartPole-v1", categorical_action_encoding=categorical),
    )
    env.set_seed(0)
    return env


def make_networks(*, categorical: bool) -> tuple[ProbabilisticActor, ValueOperator]:
    torch.manual_seed(0)
    sizes = {"num_cells": [64], "activation_class": torch.nn.Tanh}
    actor = ProbabilisticActor(
        TensorDictModule(MLP(4, 2, **sizes), ["observation"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical if categorical else OneHotCategorical,
        return_log_prob=True,
    )
    return actor, ValueOperator(MLP(4, 1, **sizes), in_keys=["observation"])


@pytest.mark.parametrize("categorical", [False, True])
def test_losses_of_collected_slices(categorical: bool) -> None:
    actor, critic = make_networks(categorical=categorical)
    with torch.no_grad():
        env = make_env(2, categorical=categorical)
        batch = env.rollout(30, actor, break_when_any_done=False)
    assert batch["next", "done"].any()
    keys = set(batch.keys(True, True))
    loss = A3CLoss(actor, critic, reduction="none")
    out = loss(batch)
    torch.testing.assert_close(
        out["loss_objective"] / -batch["action_log_prob"],
        loss(batch.select(*loss.in_keys))["loss_objective"] / -batch["action_log_prob"],
    )
    values = critic(batch.copy())["state_value"].squeeze(-1)
    advantage = out["loss_objective"] / -batch["action_log_prob"]
    torch.testing.assert_close(
        out["loss_critic"], 0.5 * advantage**2, atol=1e-4, rtol=1e-3
    )
    assert all(out[key].shape == values.shape for key in LOSSES)
    assert set(batch.keys(True, True)) == keys
    sum(out[key].sum() for key in LOSSES).backward()
    for network in (actor, critic):
        assert all(p.grad is not None and p.grad.any() for p in network.parameters())


def test_actions_of_another_encoding_are_refused() -> None:
    actor, critic = make_networks(categorical=True)
    batch = make_env(2, categorical=False).rollout(3)
    with pytest.raises(
        ValueError, match=r"shape \[2, 3\] of the policy's Categorical, got \[2, 3, 2\]"
    ):
        A3CLoss(actor, critic)(batch)


def mean_return(env: EnvBase, policy: TensorDictModule | RandomPolicy) -> float:
    """Reward per episode over 500 decisions; CartPole pays 1 for each decision."""
    with torch.no_grad():
        following = env.rollout(500, policy, break_when_any_done=False)["next"]
    return float(following["reward"].sum() / following["done"].sum().clamp_min(1))


@pytest.mark.slow
@pytest.mark.parametrize("categorical", [False, True])
def test_it_learns_cartpole(categorical: bool) -> None:
    """Random play lasts 22 decisions; within 24,000 decisions it lasts over 60."""
    env = make_env(16, categorical=categorical)
    actor, critic = make_networks(categorical=categorical)
    assert mean_return(env, RandomPolicy(env.full_action_spec)) < 30
    loss = A3CLoss(actor, critic, reduction="mean")
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-3)
    collector = Collector(env, actor, frames_per_batch=160, total_frames=24_000)
    for batch in collector:
        out = loss(batch)
        optimizer.zero_grad()
        sum(out[key] for key in LOSSES).backward()
        torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
        optimizer.step()
    assert mean_return(env, actor) > 60
    collector.shutdown()
