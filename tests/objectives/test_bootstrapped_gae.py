import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.objectives.value import GAE

from tests.objectives.slices import ToldCritic, n_step_returns, random_ends
from toponav.objectives import bootstrapped_gae


def given_slice(
    reward: list[float], told: list[float], *, done: list[int], terminated: list[int]
) -> TensorDict:
    following = {
        "reward": torch.tensor(reward).reshape(1, -1, 1),
        "told": torch.tensor(told).reshape(1, -1, 1),
        "done": torch.tensor(done, dtype=torch.bool).reshape(1, -1, 1),
        "terminated": torch.tensor(terminated, dtype=torch.bool).reshape(1, -1, 1),
    }
    return TensorDict({"next": following}, [1, len(reward)])


def test_worked_numbers() -> None:
    batch = given_slice(
        [1, 1, 1, 1, 1], [9, 10, 9, 20, 40], done=[0, 1, 0, 1, 0], terminated=[0] * 5
    )
    batch["next", "terminated"][0, 3] = True
    values = torch.tensor([1.0, 2, 3, 4, 5]).reshape(1, 5, 1)
    advantage, target = bootstrapped_gae(
        batch, values, ToldCritic(), gamma=0.5, lmbda=1.0
    )
    # From the end: 1 + 40 / 2 = 21 at the slice's end; 1 at the terminated end, which
    # nothing follows; 1 + 1 / 2 before it; 1 + 10 / 2 = 6 at the end by the clock; and
    # 1 + 6 / 2 before it.
    assert target.flatten().tolist() == [4, 6, 1.5, 1, 21]
    assert advantage.flatten().tolist() == [3, 4, -1.5, -3, 16]


def test_only_the_states_at_ends_are_judged() -> None:
    batch = given_slice([0] * 4, [1, 2, 3, 4], done=[0, 1, 1, 0], terminated=[0] * 4)
    batch["next", "terminated"][0, 2] = True
    critic = ToldCritic()
    bootstrapped_gae(batch, torch.zeros(1, 4, 1), critic, gamma=0.9, lmbda=1.0)
    (asked,) = critic.asked
    assert asked["next", "told"].flatten().tolist() == [2, 4]


def test_a_slice_of_terminated_ends_asks_nobody() -> None:
    batch = given_slice([1, 2], [9, 9], done=[1, 1], terminated=[1, 1])
    critic = ToldCritic()
    values = torch.zeros(1, 2, 1)
    _, target = bootstrapped_gae(batch, values, critic, gamma=0.9, lmbda=1.0)
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
    ends = random_ends(2, steps)
    reward, told, value = torch.randn(3, 2, steps, 1)
    following = {"reward": reward, "told": told, "done": ends[0], "terminated": ends[1]}
    batch = TensorDict({"next": following}, [2, steps])
    advantage, target = bootstrapped_gae(
        batch, value, ToldCritic(), gamma=gamma, lmbda=1.0
    )
    expected = n_step_returns(reward, told, ends, gamma)
    torch.testing.assert_close(target, expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(advantage, expected - value, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("lmbda", [0.0, 0.7, 1.0])
def test_it_equals_torchrl_s_estimator_of_a_critic_without_memory(lmbda: float) -> None:
    torch.manual_seed(0)
    layer = torch.nn.Linear(3, 1)
    critic = TensorDictModule(layer, in_keys=["view"], out_keys=["state_value"])
    done, terminated = random_ends(4, 9)
    view, after = torch.randn(2, 4, 9, 3)
    inside = ~done[:, :-1].squeeze(-1)
    after[:, :-1][inside] = view[:, 1:][inside]
    following = {"view": after, "reward": torch.randn(4, 9, 1), "done": done}
    following["terminated"] = terminated
    batch = TensorDict({"view": view, "next": following}, [4, 9])

    class Judge:
        def next_values(self, tensordict: TensorDict) -> torch.Tensor:
            return layer(tensordict["next", "view"]).detach()

    ours = bootstrapped_gae(
        batch,
        layer(view),
        Judge(),
        gamma=0.9,
        lmbda=lmbda,  # type: ignore[arg-type]
    )
    for shifted in (False, True):
        # Shifted is one pass with room for the states where episodes end.
        estimator = GAE(
            gamma=0.9,
            lmbda=lmbda,
            value_network=critic,
            shifted=shifted,
            shifted_budget=1 + int(done.sum()),
        )
        theirs = estimator(batch.clone())
        torch.testing.assert_close(ours[0], theirs["advantage"])
        torch.testing.assert_close(ours[1], theirs["value_target"])


def test_no_gradient_flows_into_the_targets() -> None:
    batch = given_slice([1, 1], [2, 2], done=[0, 0], terminated=[0, 0])
    values = torch.zeros(1, 2, 1, requires_grad=True)
    results = bootstrapped_gae(batch, values, ToldCritic(), gamma=0.9, lmbda=0.9)
    assert not any(result.requires_grad for result in results)


def test_keys_can_be_set() -> None:
    batch = given_slice([1, 1], [2, 2], done=[0, 0], terminated=[0, 0])
    batch["next", "agent", "pay"] = batch["next"].pop("reward")
    values = torch.zeros(1, 2, 1)
    _, target = bootstrapped_gae(
        batch, values, ToldCritic(), gamma=1.0, lmbda=1.0, reward=("agent", "pay")
    )
    assert target.flatten().tolist() == [4, 3]


def test_shapes_that_differ_are_refused() -> None:
    batch = given_slice([1, 1], [2, 2], done=[0, 0], terminated=[0, 0])
    batch["next", "reward"] = batch["next", "reward"].squeeze(-1)
    with pytest.raises(ValueError, match=r"'reward'.*\[1, 2, 1\].*got \[1, 2\]"):
        bootstrapped_gae(
            batch, torch.zeros(1, 2, 1), ToldCritic(), gamma=0.9, lmbda=1.0
        )
