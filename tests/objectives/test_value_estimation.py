import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.modules import (
    MLP,
    LSTMModule,
    OneHotCategorical,
    ProbabilisticActor,
    ValueOperator,
    set_recurrent_mode,
)
from torchrl.objectives import ValueEstimators
from torchrl.objectives.value import (
    GAE,
    TD0Estimator,
    TD1Estimator,
    TDLambdaEstimator,
)

from tests.objectives.slices import GivenCritic, n_step_returns, random_ends
from toponav.objectives import A3CLoss, TRPOLoss
from toponav.objectives.actor_critic_loss import bootstrapped_advantage


def given_slice(
    reward: list[float], values: list[float], *, done: list[int], terminated: list[int]
) -> TensorDict:
    following = {
        "reward": torch.tensor(reward).reshape(1, -1, 1),
        "given": torch.tensor(values).reshape(1, -1, 1),
        "done": torch.tensor(done, dtype=torch.bool).reshape(1, -1, 1),
        "terminated": torch.tensor(terminated, dtype=torch.bool).reshape(1, -1, 1),
    }
    return TensorDict({"next": following}, [1, len(reward)])


def estimate(
    batch: TensorDict, critic: GivenCritic, *, gamma: float, lmbda: float = 1.0
) -> tuple[Tensor, Tensor]:
    loss = A3CLoss(critic)
    loss.make_value_estimator(ValueEstimators.GAE, gamma=gamma, lmbda=lmbda)
    return bootstrapped_advantage(loss, batch, critic.state_value, critic.next_values)


def test_worked_numbers() -> None:
    batch = given_slice(
        [1, 1, 1, 1, 1], [9, 10, 9, 20, 40], done=[0, 1, 0, 1, 0], terminated=[0] * 5
    )
    batch["next", "terminated"][0, 3] = True
    critic = GivenCritic(torch.tensor([1.0, 2, 3, 4, 5]).reshape(1, 5, 1))
    advantage, target = estimate(batch, critic, gamma=0.5)
    # From the end: 1 + 40 / 2 = 21 at the slice's end; 1 at the terminated end, which
    # nothing follows; 1 + 1 / 2 before it; 1 + 10 / 2 = 6 at the truncated end; and
    # 1 + 6 / 2 before it.
    assert target.flatten().tolist() == [4, 6, 1.5, 1, 21]
    assert advantage.flatten().tolist() == [3, 4, -1.5, -3, 16]


def test_only_the_states_at_ends_are_judged() -> None:
    batch = given_slice([0] * 4, [1, 2, 3, 4], done=[0, 1, 1, 0], terminated=[0] * 4)
    batch["next", "terminated"][0, 2] = True
    critic = GivenCritic(torch.zeros(1, 4, 1))
    estimate(batch, critic, gamma=0.9)
    (asked,) = critic.asked
    assert asked["next", "given"].flatten().tolist() == [2, 4]


def test_a_slice_of_terminated_ends_asks_nobody() -> None:
    batch = given_slice([1, 2], [9, 9], done=[1, 1], terminated=[1, 1])
    critic = GivenCritic(torch.zeros(1, 2, 1))
    _, target = estimate(batch, critic, gamma=0.9)
    assert critic.asked == []
    assert target.flatten().tolist() == [1, 2]


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    steps=st.integers(1, 8),
    gamma=st.sampled_from([0.0, 0.5, 0.99, 1.0]),
)
def test_lambda_one_gives_n_step_returns(seed: int, steps: int, gamma: float) -> None:
    torch.manual_seed(seed)
    done, terminated = random_ends(2, steps)
    reward, values, value = torch.randn(3, 2, steps, 1)
    following = {"reward": reward, "given": values}
    following |= {"done": done, "terminated": terminated}
    batch = TensorDict({"next": following}, [2, steps])
    advantage, target = estimate(batch, GivenCritic(value), gamma=gamma)
    expected = n_step_returns(reward, values, (done, terminated), gamma)
    torch.testing.assert_close(target, expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(advantage, expected - value, atol=1e-5, rtol=1e-5)


def plain_slice() -> tuple[A3CLoss, TensorDict, ValueOperator]:
    """A slice of plain TorchRL networks whose episodes end inside."""
    torch.manual_seed(0)
    logits = TensorDictModule(MLP(3, 2), ["observation"], ["logits"])
    actor = ProbabilisticActor(
        logits, in_keys=["logits"], distribution_class=OneHotCategorical
    )
    critic = ValueOperator(MLP(3, 1), in_keys=["observation"])
    done, terminated = random_ends(4, 9)
    view, after = torch.randn(2, 4, 9, 3)
    inside = ~done[:, :-1].squeeze(-1)
    after[:, :-1][inside] = view[:, 1:][inside]
    following = {"observation": after, "reward": torch.randn(4, 9, 1)}
    following |= {"done": done, "terminated": terminated}
    batch = TensorDict({"observation": view, "next": following}, [4, 9])
    actor(critic(batch))
    return A3CLoss(actor, critic), batch.detach(), critic


@pytest.mark.parametrize("kind", [A3CLoss, TRPOLoss])
def test_a_recurrent_critic_of_torchrl_judges_each_end_by_itself(kind: type) -> None:
    """By the memory that is stored with it, whatever the rows beside it show."""
    loss, batch, _ = plain_slice()
    memory = LSTMModule(3, 4, in_key="observation", out_key="memory")
    head = ValueOperator(MLP(4, 1), in_keys=["memory"])
    loss = kind(loss.actor_network, TensorDictSequential(memory, head))
    never = torch.zeros(4, 9, 1, dtype=torch.bool)
    batch["next"].update({"done": never, "terminated": never})
    for side in (batch, batch["next"]):
        states = {key: torch.randn(4, 9, 1, 4) for key in memory.in_keys[1:3]}
        side.update({**states, "is_init": never})

    def targets(rows: TensorDict) -> Tensor:
        # As in a loss's `forward`.
        with set_recurrent_mode(True):
            value = loss._judge(rows)
            written = loss._write_advantage(rows.copy(), value, normalize=False)
        return written["value_target"]

    together = targets(batch)
    for row in range(4):
        torch.testing.assert_close(together[row], targets(batch[row : row + 1])[0])


ESTIMATORS = {
    ValueEstimators.TD0: (TD0Estimator, {"gamma": 0.9}),
    ValueEstimators.TD1: (TD1Estimator, {"gamma": 0.9}),
    ValueEstimators.TDLambda: (TDLambdaEstimator, {"gamma": 0.9, "lmbda": 0.7}),
    ValueEstimators.GAE: (GAE, {"gamma": 0.9, "lmbda": 0.7}),
}


@pytest.mark.parametrize("value_type", ESTIMATORS)
def test_each_estimator_equals_torchrl_s(value_type: ValueEstimators) -> None:
    loss, batch, critic = plain_slice()
    kind, hyperparams = ESTIMATORS[value_type]
    loss.make_value_estimator(value_type, **hyperparams)
    assert loss.value_type == value_type
    ours = bootstrapped_advantage(loss, batch, batch["state_value"], loss._next_values)
    theirs = kind(value_network=critic, **hyperparams)(batch.exclude("state_value"))
    torch.testing.assert_close(ours[0], theirs["advantage"])
    torch.testing.assert_close(ours[1], theirs["value_target"])


@pytest.mark.parametrize("value_type", ESTIMATORS)
def test_estimators_are_made_of_torchrl_s_classes(value_type: ValueEstimators) -> None:
    loss, batch, critic = plain_slice()
    kind, hyperparams = ESTIMATORS[value_type]
    expected = loss.make_value_estimator(value_type, **hyperparams)(batch)
    for network in ({}, {"value_network": critic}):
        loss.make_value_estimator(kind, **hyperparams, **network)
        assert type(loss.value_estimator) is kind is loss.value_type
        torch.testing.assert_close(loss(batch), expected)


@pytest.mark.parametrize("value_type", ESTIMATORS)
def test_a_gamma_of_zero_leaves_the_reward(value_type: ValueEstimators) -> None:
    loss, batch, _ = plain_slice()
    loss.make_value_estimator(value_type, gamma=0)
    value = batch["state_value"]
    _, target = bootstrapped_advantage(loss, batch, value, loss._next_values)
    torch.testing.assert_close(target, batch["next", "reward"])


def test_the_defaults_are_torchrl_s() -> None:
    loss, _, _ = plain_slice()
    # The n-step return of A3C is TD(1).
    assert (loss.value_estimator.gamma, loss.value_estimator.lmbda) == (0.99, 1)
    loss.make_value_estimator(ValueEstimators.GAE)
    assert (loss.value_estimator.gamma, loss.value_estimator.lmbda) == (
        torch.tensor(0.99),
        torch.tensor(0.95),
    )


def test_an_estimator_of_torchrl_is_taken_as_it_is() -> None:
    loss, batch, critic = plain_slice()
    estimator = GAE(gamma=0.5, lmbda=0.5, value_network=critic, average_gae=True)
    loss.make_value_estimator(estimator)
    assert loss.value_estimator is estimator
    ours = bootstrapped_advantage(loss, batch, batch["state_value"], loss._next_values)
    torch.testing.assert_close(
        ours[0], estimator(batch.exclude("state_value"))["advantage"]
    )


def test_no_gradient_flows_into_the_targets() -> None:
    batch = given_slice([1, 1], [2, 2], done=[0, 0], terminated=[0, 0])
    critic = GivenCritic(torch.zeros(1, 2, 1, requires_grad=True))
    results = estimate(batch, critic, gamma=0.9, lmbda=0.9)
    assert not any(result.requires_grad for result in results)


def test_what_does_not_fit_is_refused() -> None:
    critic = GivenCritic(torch.zeros(1, 2, 1))
    batch = given_slice([1, 1], [2, 2], done=[0, 0], terminated=[0, 0])
    flat = batch.clone()
    flat["next", "reward"] = flat["next", "reward"].squeeze(-1)
    with pytest.raises(ValueError, match=r"'reward'.*\[1, 2, 1\].*got \[1, 2\]"):
        estimate(flat, critic, gamma=0.9)
    with pytest.raises(KeyError, match=r"next.*done.* the key of done"):
        estimate(batch.exclude(("next", "done")), critic, gamma=0.9)
    with pytest.raises(ValueError, match=r"gamma must be in \[0, 1\], got 1.5"):
        estimate(batch, critic, gamma=1.5)
    loss = A3CLoss(critic)
    with pytest.raises(NotImplementedError, match=r"for A3CLoss, got .*VTrace"):
        loss.make_value_estimator(ValueEstimators.VTrace)
    with pytest.raises(ValueError, match=r"not be given with TD0, got 0\.5"):
        loss.make_value_estimator(ValueEstimators.TD0, lmbda=0.5)
