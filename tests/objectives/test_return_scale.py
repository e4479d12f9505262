import pytest
import torch
from tensordict import TensorDict

from toponav.objectives import ReturnScale


def make_batch(
    reward: torch.Tensor,
    done: torch.Tensor | None = None,
    env_id: list[int] | None = None,
) -> TensorDict:
    """Rewards ``[E, T]`` as a batch."""
    if done is None:
        done = torch.zeros_like(reward, dtype=torch.bool)
    following = {"intrinsic_reward": reward.unsqueeze(-1), "done": done.unsqueeze(-1)}
    batch = TensorDict({"next": following}, reward.shape)
    if env_id is not None:
        number = torch.tensor(env_id).reshape(-1, 1, 1)
        batch["env_id"] = number.expand(*reward.shape, 1)
    return batch


def scaled(scale: ReturnScale, batch: TensorDict) -> torch.Tensor:
    result: torch.Tensor = scale(batch)["next", "scaled_reward"]
    return result.squeeze(-1)


def test_worked_numbers_with_an_episode_s_end() -> None:
    scale = ReturnScale(1, gamma=0.5)
    done = torch.tensor([[False, True, False, False]])
    batch = make_batch(torch.tensor([[2.0, 4, 1, 0]]), done)
    # The returns are 2, 4 + 1 = 5, then again 1, 0.5: mean 2.125, variance
    # (4 + 25 + 1 + 0.25) / 4 - 4.515625 = 3.046875.
    expected = torch.tensor([[2.0, 4, 1, 0]]) / 3.046875**0.5
    torch.testing.assert_close(scaled(scale, batch), expected)
    assert batch["next", "intrinsic_reward"].flatten().tolist() == [2, 4, 1, 0]


def test_batches_count_as_one_long_one() -> None:
    torch.manual_seed(0)
    reward, done = torch.rand(3, 12), torch.rand(3, 12) < 0.2
    whole, apart = ReturnScale(3, gamma=0.9), ReturnScale(3, gamma=0.9)
    whole(make_batch(reward, done))
    for part in (slice(0, 5), slice(5, 6), slice(6, 12)):
        apart(make_batch(reward[:, part], done[:, part]))
    torch.testing.assert_close(apart.deviation, whole.deviation)
    torch.testing.assert_close(apart.running_return, whole.running_return)


def test_workers_may_bring_their_envs_in_any_order() -> None:
    torch.manual_seed(0)
    reward = torch.rand(4, 6)
    together, apart = ReturnScale(4, gamma=0.9), ReturnScale(4, gamma=0.9)
    together(make_batch(reward))
    for rows in ([3, 1], [0, 2]):
        for steps in (slice(0, 3), slice(3, 6)):
            apart(make_batch(reward[rows, steps], env_id=rows))
    torch.testing.assert_close(apart.deviation, together.deviation)
    torch.testing.assert_close(apart.running_return, together.running_return)


def test_the_scale_of_the_rewards_cancels() -> None:
    torch.manual_seed(0)
    reward = torch.rand(3, 50)
    small, large = ReturnScale(3), ReturnScale(3)
    torch.testing.assert_close(
        scaled(small, make_batch(reward)), scaled(large, make_batch(1000 * reward))
    )


def test_scaled_returns_have_a_deviation_of_one() -> None:
    torch.manual_seed(0)
    scale = ReturnScale(4, gamma=0.9)
    rewards = scaled(scale, make_batch(torch.rand(4, 200)))
    again = ReturnScale(4, gamma=0.9)
    again(make_batch(rewards))
    assert again.deviation.item() == pytest.approx(1, abs=1e-4)


def test_no_rewards_yet_is_no_division_by_zero() -> None:
    scale = ReturnScale(2)
    assert scale.deviation == 1
    assert not scaled(scale, make_batch(torch.zeros(2, 5))).any()


def test_a_first_large_reward_is_clipped() -> None:
    reward = torch.zeros(1, 1000)
    reward[0, -1] = -5
    # The returns are 0 but for the last: the deviation is 5 sqrt(.001 - .001**2).
    free = scaled(ReturnScale(1, clip=None), make_batch(reward))[0, -1]
    assert free.item() == pytest.approx(-1 / (0.001 - 0.001**2) ** 0.5, rel=1e-4)
    assert scaled(ReturnScale(1), make_batch(reward))[0, -1] == -10


def test_switched_off_it_copies_and_counts_nothing() -> None:
    scale = ReturnScale(2, enabled=False)
    reward = 100 * torch.rand(2, 5)
    assert torch.equal(scaled(scale, make_batch(reward)), reward)
    assert scale.deviation == 1


def test_it_goes_on_from_its_state_dict() -> None:
    torch.manual_seed(0)
    scale, other = ReturnScale(2), ReturnScale(2)
    scale(make_batch(torch.rand(2, 5)))
    other.load_state_dict(scale.state_dict())
    batch = make_batch(torch.rand(2, 5))
    assert torch.equal(scaled(scale, batch.clone()), scaled(other, batch.clone()))


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="num_envs must be at least 1, got 0"):
        ReturnScale(0)
    with pytest.raises(ValueError, match="gamma must be at least 0 and below 1, got 1"):
        ReturnScale(1, gamma=1.0)
    with pytest.raises(ValueError, match=r"gamma must be at least 0 .* got 1\.5"):
        ReturnScale(1, gamma=1.5, enabled=False)
    # Nothing is summed without end where nothing is counted.
    ReturnScale(1, gamma=1.0, enabled=False)
    with pytest.raises(ValueError, match="clip must be above 0 or None, got 0"):
        ReturnScale(1, clip=0)
    with pytest.raises(ValueError, match=r"must be \[E, T\], a row an env, got \[12\]"):
        ReturnScale(3)(make_batch(torch.zeros(3, 4)).reshape(-1))
    batch = make_batch(torch.zeros(2, 4))
    for key in ("intrinsic_reward", "done"):
        with pytest.raises(KeyError, match=f"must have .*next.*{key}"):
            ReturnScale(2)(batch.exclude(("next", key)))
    with pytest.raises(ValueError, match="got 2 and the env 2"):
        ReturnScale(2)(make_batch(torch.zeros(3, 4)))
    batch["collector", "mask"] = torch.ones(2, 4, dtype=torch.bool)
    ReturnScale(2)(batch)["collector", "mask"][1, 1:] = False
    with pytest.raises(
        ValueError, match=r"without padding.* out 3 decisions: scale be"
    ):
        ReturnScale(2)(batch)
