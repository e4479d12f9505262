"""The A3C loss with a plain actor and critic of TorchRL on a task of Gymnasium."""

import pytest
import torch
from tensordict.nn import CompositeDistribution, TensorDictModule
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, GymEnv, SerialEnv
from torchrl.envs.utils import RandomPolicy
from torchrl.modules import MLP, OneHotCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import A2CLoss, ValueEstimators

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


def test_actions_out_of_range_are_refused() -> None:
    for categorical in (True, False):
        actor, critic = make_networks(categorical=categorical)
        batch = make_env(2, categorical=categorical).rollout(3)
        with pytest.raises(ValueError, match=r"action must be .*, got"):
            A3CLoss(actor, critic)(batch.set("action", batch["action"] + 7))
        with pytest.raises(ValueError, match=r"integers or bools, got torch.float32"):
            A3CLoss(actor, critic)(batch.set("action", batch["action"].float()))


def test_a_critic_of_another_key_needs_set_keys() -> None:
    actor, critic = make_networks(categorical=True)
    batch = critic(make_env(2, categorical=True).rollout(3)).detach()
    expected = A3CLoss(actor, critic)(batch)
    loss = A3CLoss(actor, ValueOperator(critic.module, ["observation"], ["worth"]))
    with pytest.raises(KeyError, match=r"'state_value', .*set_keys\(value=.*'worth'"):
        loss(batch)
    loss.set_keys(value="worth")
    assert (loss(batch) == expected).all()
    two = ValueOperator(MLP(4, 2), ["observation"])
    with pytest.raises(ValueError, match=r"shape \[2, 3, 1\], got \[2, 3, 2\]"):
        A3CLoss(actor, two)(batch)


def test_policies_of_several_actions_are_refused() -> None:
    module = TensorDictModule(MLP(4, 2), ["observation"], [("params", "a", "logits")])
    _, critic = make_networks(categorical=True)
    for names in (["a"], ["a", "b"]):
        actor = ProbabilisticActor(
            module,
            in_keys=["params"],
            out_keys=names,
            distribution_class=CompositeDistribution,
            distribution_kwargs={"distribution_map": dict.fromkeys(names, Categorical)},
        )
        with pytest.raises(ValueError, match=rf"one action .* with \{names}"):
            A3CLoss(actor, critic)
    with pytest.raises(ValueError, match=r"one action .* MLP with \[\]"):
        A3CLoss(MLP(4, 2), critic)


def test_its_state_dict_is_a2c_s() -> None:
    actor, critic = make_networks(categorical=True)
    theirs = A2CLoss(actor, critic, functional=False)
    loss = A3CLoss(actor, critic)
    assert list(loss.state_dict()) == list(theirs.state_dict())
    assert loss.functional is theirs.functional is False
    read = {"advantage", "value_target", "value", "action", "reward"}
    read |= {"done", "terminated"}
    for name in read:
        assert getattr(loss.tensor_keys, name) == getattr(theirs.tensor_keys, name)


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
