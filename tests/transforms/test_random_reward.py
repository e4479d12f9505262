from functools import partial

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from tests.checks import check_parallel, check_transform
from tests.fakes import FakeMaze
from toponav.keys import INTRINSIC_REWARD, PIXELS
from toponav.transforms import EmbedViews, PreviousReward, RandomReward


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def mean_colour(views):
    return views.float().mean((1, 2))


def make_chain():
    return Compose(
        EmbedViews(mean_colour, in_keys=[PIXELS]),
        RandomReward(seed=0),
        PreviousReward(in_keys=[INTRINSIC_REWARD]),
    )


def rewards(seed, decisions=50, **arguments):
    env = TransformedEnv(make_maze([4]), RandomReward(seed, **arguments))
    return env.rollout(decisions, break_when_any_done=False)["next"]


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, make_chain)


def test_specs_hold_for_keys_of_ones_own():
    def make():
        return Compose(
            EmbedViews(mean_colour, in_keys=[PIXELS], out_keys=[("mine", "code")]),
            RandomReward(out_keys=[("mine", "luck")]),
        )

    check_transform(make_maze, make)


@pytest.mark.slow
def test_specs_hold_in_processes():
    check_parallel(make_maze, make_chain)


def test_it_is_uniform_and_the_tasks_reward_is_untouched():
    data = rewards(0, decisions=1000)
    drawn = data[INTRINSIC_REWARD]
    assert drawn.shape == (4, 1000, 1)
    assert drawn.dtype is torch.float32
    assert 0 <= drawn.min() < drawn.max() < 1
    # 4000 draws: mean 0.5 +- 0.0046, variance 1 / 12 +- 0.0012.
    assert drawn.mean().item() == pytest.approx(0.5, abs=0.02)
    assert drawn.var().item() == pytest.approx(1 / 12, abs=0.005)
    assert set(data["reward"].unique().tolist()) <= {0.0, 10.0}


def test_envs_and_decisions_differ():
    drawn = rewards(0)[INTRINSIC_REWARD]
    assert len(drawn.unique()) > 190


def test_the_same_seed_draws_the_same():
    torch.manual_seed(1)
    first = rewards(3)[INTRINSIC_REWARD]
    torch.manual_seed(2)
    assert torch.equal(rewards(3)[INTRINSIC_REWARD], first)
    assert not torch.equal(rewards(4)[INTRINSIC_REWARD], first)
    transform = RandomReward()
    transform.set_seed(3)
    env = TransformedEnv(make_maze([4]), transform)
    drawn = env.rollout(50, break_when_any_done=False)["next", INTRINSIC_REWARD]
    assert torch.equal(drawn, first)
    assert not torch.equal(
        rewards(None)[INTRINSIC_REWARD], rewards(None)[INTRINSIC_REWARD]
    )


def test_a_resumed_run_draws_what_comes_next():
    data = make_maze([2]).reset()
    saved, loaded = RandomReward(0), RandomReward(1)
    saved._step(data, data)
    loaded.load_state_dict(saved.state_dict())
    one, other = (each._step(data, data.clone()) for each in (saved, loaded))
    assert torch.equal(one[INTRINSIC_REWARD], other[INTRINSIC_REWARD])


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="in_keys must be 0 and out_keys 1"):
        RandomReward(out_keys=["a", "b"])
    with pytest.raises(ValueError, match="out_keys must match"):
        EmbedViews(mean_colour, out_keys=["a", "b"])
    wrong = partial(EmbedViews, lambda views: views, in_keys=[PIXELS])
    with pytest.raises(ValueError, match=r"embed must return \[N, D\], got \[1, 12"):
        TransformedEnv(FakeMaze(), wrong()).observation_spec  # noqa: B018
