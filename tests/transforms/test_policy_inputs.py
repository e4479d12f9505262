from functools import partial

import numpy as np
import pytest
import torch
from PIL import Image
from tensordict import TensorDict
from torchrl.data import OneHot
from torchrl.envs import Compose, Transform, TransformedEnv
from torchrl.testing.mocking_classes import DiscreteActionVecMockEnv

from tests.checks import check_transform
from tests.fakes import FakeMaze
from toponav import keys
from toponav.transforms import PolicyPixels, PreviousAction, PreviousReward

NONE = 6


def make_maze(batch_size, **arguments):
    return FakeMaze(batch_size=batch_size, max_decisions=4, **arguments)


def make_inputs():
    return Compose(
        PolicyPixels((6, 9)), PreviousAction(6), PreviousReward(in_keys=["reward"])
    )


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, make_inputs)


def test_specs_hold_for_float_views_and_keys_of_ones_own():
    check_transform(
        partial(make_maze, float_pixels=True),
        lambda: Compose(
            PolicyPixels((5, 5), out_keys=[("mine", "view")]),
            PreviousAction(6, out_keys=[("mine", "act")]),
            PreviousReward(in_keys=["reward"], out_keys=[("mine", "paid")]),
        ),
    )


def test_policy_pixels_are_what_pillow_makes_of_them():
    view = torch.randint(256, (120, 160, 3), generator=torch.Generator().manual_seed(0))
    view = view.to(torch.uint8)
    small = PolicyPixels()(TensorDict({"pixels": view}))["policy_pixels"]
    wanted = Image.fromarray(view.numpy()).resize((84, 84), Image.Resampling.BILINEAR)
    difference = np.abs(small.numpy().astype(int) - np.asarray(wanted).astype(int))
    assert difference.max() <= 1


def test_policy_pixels_keep_the_mean_of_a_fine_pattern():
    # A chequerboard of single pixels, which sampling would turn into stripes.
    board = (torch.arange(120).unsqueeze(1) + torch.arange(160)) % 2 * 200
    view = board.to(torch.uint8).unsqueeze(-1).expand(2, 120, 160, 3)
    small = PolicyPixels()(TensorDict({"pixels": view}, [2]))["policy_pixels"]
    inner = small[:, 2:-2, 2:-2].float()
    assert inner.mean().item() == pytest.approx(100, abs=1)
    assert inner.std().item() < 20


def test_policy_pixels_do_not_share_memory_with_the_view():
    view = torch.zeros(1, 84, 84, 3, dtype=torch.uint8)
    small = PolicyPixels()(TensorDict({"pixels": view}, [1]))["policy_pixels"]
    view.fill_(9)
    assert small.max().item() == 0
    assert small.is_contiguous()


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_policy_pixels_have_the_envs_batch(batch):
    view = torch.zeros(*batch, 12, 16, 3, dtype=torch.uint8)
    data = PolicyPixels((5, 7))(TensorDict({"pixels": view}, batch))
    assert data["policy_pixels"].shape == (*batch, 5, 7, 3)


def rollout(env, decisions=9):
    return env.rollout(decisions, break_when_any_done=False)


def test_the_previous_action_is_the_one_before():
    data = rollout(TransformedEnv(make_maze([3]), PreviousAction(6)))
    before = data[keys.PREVIOUS_ACTION].squeeze(-1)
    # Episodes have four decisions: an episode starts at 0, 4 and 8.
    for start in (0, 4, 8):
        assert (before[:, start] == NONE).all()
    for decision in (1, 2, 3, 5, 6, 7):
        assert (before[:, decision] == data["action"][:, decision - 1]).all()
    assert before.dtype is torch.int64


class Mirrored(Transform):
    """Gives the env the opposite of each action, 5 - a."""

    def __init__(self):
        super().__init__(in_keys_inv=["action"], out_keys_inv=["action"])

    def _inv_apply_transform(self, action):
        return 5 - action


@pytest.mark.parametrize("key", ["act", ("mine", "act")])
def test_it_is_the_action_as_those_behind_it_see_it(key):
    first, last = PreviousAction(6), PreviousAction(6, out_keys=[key])
    env = TransformedEnv(make_maze([3]), Compose(first, Mirrored(), last))
    data = rollout(env, 4)
    taken = data["action"][:, :-1]
    assert torch.equal(data[key][:, 1:].squeeze(-1), taken)
    assert torch.equal(data[keys.PREVIOUS_ACTION][:, 1:].squeeze(-1), 5 - taken)
    assert set(data.keys()) == {*env.reset().keys(), "action", "next"}


def test_one_hot_actions_become_numbers():
    env = TransformedEnv(DiscreteActionVecMockEnv(), PreviousAction(7))
    assert isinstance(env.action_spec, OneHot)
    data = env.rollout(5)
    assert data["previous_action"][0].item() == 7
    numbers = data["action"].to(torch.uint8).argmax(-1)
    assert (data["previous_action"][1:, 0] == numbers[:-1]).all()


def test_the_previous_reward_is_clipped_and_the_reward_is_not():
    class Paying(FakeMaze):
        def _step(self, tensordict):
            result = super()._step(tensordict)
            paid = torch.tensor([[0.25], [-3.0], [10.0]])
            return result.set("reward", paid * self.clock.unsqueeze(-1))

    env = TransformedEnv(
        Paying(batch_size=[3], max_decisions=4), PreviousReward(in_keys=["reward"])
    )
    data = rollout(env)
    before = data[keys.PREVIOUS_REWARD].squeeze(-1)
    expected = [0, 0.25, 0.5, 0.75, 0, 0.25, 0.5, 0.75, 0]
    assert before[0].tolist() == expected
    assert before[1].tolist() == [-float(paid > 0) for paid in expected]
    assert before[2].tolist() == [float(paid > 0) for paid in expected]
    assert data["next", "reward"][2].max().item() == 40


def test_a_partial_reset_forgets_only_the_rows_that_restart():
    env = TransformedEnv(
        make_maze([3]),
        Compose(PreviousAction(6), PreviousReward(in_keys=["reward"])),
    )
    first = env.reset()
    first["action"] = torch.tensor([3, 4, 5])
    after = env.step(first)["next"]
    after[keys.PREVIOUS_REWARD] = torch.full((3, 1), 0.5)
    after["_reset"] = torch.tensor([[False], [True], [False]])
    now = env.reset(after)
    assert now[keys.PREVIOUS_ACTION].squeeze(-1).tolist() == [3, NONE, 5]
    assert now[keys.PREVIOUS_REWARD].squeeze(-1).tolist() == [0.5, 0.0, 0.5]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (partial(PolicyPixels, (0, 84)), r"size must be .* got \(0, 84\)"),
        (partial(PolicyPixels, out_keys=["a", "b"]), "out_keys must match"),
        (partial(PreviousAction, 1), "num_actions must be at least 2, got 1"),
        (
            partial(PreviousAction, 6, in_keys=["a", "b"]),
            "in_keys must be 1 and out_keys 1",
        ),
        (partial(PreviousReward, 0.0), "clip must be above 0, got 0.0"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            partial(PolicyPixels, in_keys=["rgb"]),
            "'rgb' must be an observation of the env, got",
        ),
        (partial(PolicyPixels, in_keys=[keys.CELL]), r"must be images, got \[2\]"),
        (partial(PreviousAction, 7), "num_actions must be that of 'action', 6, got 7"),
        (
            partial(PreviousAction, 6, in_keys=["act"]),
            "'act' must be an action of the env, got",
        ),
        (PreviousReward, "'intrinsic_reward' must be a reward of the env .add Intrins"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_specs(make, message):
    with pytest.raises(ValueError, match=message):
        TransformedEnv(FakeMaze(), make()).output_spec  # noqa: B018
