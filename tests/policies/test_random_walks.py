import pickle

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import GymEnv

from tests.envs import fake_engine
from tests.fakes import WORLD
from toponav.keys import ACTION
from toponav.policies import RandomPolicy, StickyPolicy, forward_weights


def actions(policy, *, times, num_envs=50):
    empty = TensorDict(batch_size=[num_envs])
    return torch.stack([policy(empty.clone())[ACTION] for _ in range(times)])


def test_random_policy_draws_every_action_equally_often():
    counts = actions(RandomPolicy(6, seed=0), times=120).flatten().bincount(minlength=6)
    # 6000 draws: 1000 each, standard deviation sqrt(6000 * 1/6 * 5/6) = 28.9.
    assert ((counts - 1000).abs() < 4 * 28.9).all()


@pytest.mark.parametrize("make", [RandomPolicy, StickyPolicy])
def test_same_seed_same_actions(make):
    first = actions(make(6, seed=3), times=20)
    assert torch.equal(first, actions(make(6, seed=3), times=20))
    assert (first != actions(make(6, seed=4), times=20)).any()


@pytest.mark.parametrize("make", [RandomPolicy, StickyPolicy])
def test_copies_act_alike_and_the_docstring_says_so(make):
    policy = make(6)
    copied = pickle.loads(pickle.dumps(policy))
    assert torch.equal(actions(copied, times=5), actions(policy, times=5))
    assert "several workers need different seeds" in " ".join(make.__doc__.split())


def test_sticky_policy_repeats_as_often_as_it_should():
    drawn = actions(StickyPolicy(6, seed=0), times=201)
    repeats = (drawn[1:] == drawn[:-1]).float().mean().item()
    # Kept with 0.75, drawn again with 0.25 / 6; 10,000 pairs: sd 0.004.
    assert repeats == pytest.approx(0.75 + 0.25 / 6, abs=0.016)


def test_weights_decide_how_often_an_action_comes():
    drawn = actions(
        StickyPolicy(3, stickiness=0.0, weights=[3, 0, 1], seed=0), times=200
    ).flatten()
    shares = drawn.bincount(minlength=3) / len(drawn)
    assert shares.tolist() == pytest.approx([0.75, 0.0, 0.25], abs=0.02)


@pytest.mark.parametrize("make", [RandomPolicy, StickyPolicy])
@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_actions_have_the_shape_of_the_batch(make, shape):
    policy = make(6, seed=0)
    for _ in range(2):
        action = policy(TensorDict(batch_size=shape))[ACTION]
        assert action.shape == shape
        assert action.dtype is torch.int64


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RandomPolicy(0), "num_actions must be at least 1, got 0"),
        (
            lambda: StickyPolicy(2, stickiness=1.5),
            r"stickiness must be in \[0, 1\], got 1.5",
        ),
        (
            lambda: StickyPolicy(2, weights=[-1, 2]),
            "weights must be 2 positive numbers",
        ),
        (lambda: StickyPolicy(2, weights=[0, 0]), "weights must be 2 positive numbers"),
        (lambda: StickyPolicy(2, weights=[1]), "weights must be 2 positive numbers"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("make", [RandomPolicy, StickyPolicy])
def test_they_act_in_any_env_with_categorical_actions(make):
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    rollout = env.rollout(20, make(2, seed=0), break_when_any_done=False)
    assert rollout[ACTION].shape == (20,)
    assert set(rollout[ACTION].tolist()) == {0, 1}


def test_actions_that_move_ahead_weigh_more():
    assert forward_weights(WORLD) == (3.0, 1.0, 1.0, 1.0, 1.5, 1.5)
    assert forward_weights(fake_engine.WORLD) == (3.0, 1.0, 1.0)
