"""Views with channels first give the rewards and values of those with channels last."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase, PermuteTransform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.fakes import FakeMaze
from toponav.keys import ACTION_VALUE, FRAME_STACK, FRAMES, PIXELS, POLICY_PIXELS
from toponav.methods.learners.dqn import StackedQNetwork
from toponav.methods.rewards import (
    AmortisedExemplars,
    IntrinsicCuriosity,
    RandomNetworkDistillation,
)
from toponav.methods.rewards.grey_stack import GreyStack

SIZE = (36, 40)
ORDERS = ("HWC", "CHW")


def draw(*shape: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(256, shape, generator=generator).to(torch.uint8)


def first(views: Tensor) -> Tensor:
    return views.movedim(-1, -3)


def both(make: Callable) -> tuple:
    """The same network for either order."""
    found = []
    for channels in ORDERS:
        torch.manual_seed(0)
        found.append(make(channels=channels))
    return tuple(found)


def make_world(channels: str) -> EnvBase:
    env = FakeMaze(batch_size=(2,), max_decisions=3, image_size=SIZE)
    if channels == "HWC":
        return env
    return TransformedEnv(env, PermuteTransform((-1, -3, -2), in_keys=[PIXELS]))


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
def test_stacks_of_grey_views_are_in_the_order_of_their_views() -> None:
    seen = []
    for channels in ORDERS:
        stack = GreyStack((6, 8), 2, channels=channels)
        env = TransformedEnv(make_world(channels), stack)
        check_env_specs(env)
        env.set_seed(0)
        torch.manual_seed(0)
        seen.append(env.rollout(7, break_when_any_done=False)["next", FRAME_STACK])
    assert seen[0].shape == (2, 7, 6, 8, 2)
    assert torch.equal(first(seen[0]), seen[1])


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
@pytest.mark.parametrize(("channels", "other"), [ORDERS, ORDERS[::-1]])
def test_a_stack_refuses_views_of_the_other_order(channels: str, other: str) -> None:
    stack = GreyStack((6, 8), 2, channels=channels)
    with pytest.raises(ValueError, match=f"channels='{other}' takes them"):
        TransformedEnv(make_world(other), stack).observation_spec  # noqa: B018


def test_curiosity_about_stacks() -> None:
    def make(channels: str) -> IntrinsicCuriosity:
        return IntrinsicCuriosity(4, size=SIZE, frames=3, channels=channels)

    last, other = both(make)
    before, after = draw(2, 5, *SIZE, 3)
    action = torch.arange(5) % 4
    wanted = last(before, action, after)
    got = other(first(before), action, first(after))
    for one, same in zip(wanted, got, strict=True):
        torch.testing.assert_close(one, same)
    with pytest.raises(ValueError, match=r"must be \[N, 36, 40, 3\] with channels='H"):
        last(first(before), action, first(after))


def test_random_networks_of_views() -> None:
    def make(channels: str) -> RandomNetworkDistillation:
        options = {"width": 4, "feature_dim": 8, "channels": channels}
        return RandomNetworkDistillation(SIZE, **options)

    last, other = both(make)
    views = draw(5, *SIZE, 3)
    last.update(views)
    other.update(first(views))
    torch.testing.assert_close(last.target(views), other.target(first(views)))
    with pytest.raises(ValueError, match=r"shape \[3, 36, 40\] \(RGB, channels='CHW'"):
        other.target(views)


def test_exemplars_of_views() -> None:
    def make(channels: str) -> AmortisedExemplars:
        shape = (8, 9, 3) if channels == "HWC" else (3, 8, 9)
        return AmortisedExemplars(shape, channels=channels)

    last, other = both(make)
    other.load_state_dict(last.state_dict())
    views = draw(5, 8, 9, 3)
    torch.testing.assert_close(last.logit(views), other.logit(first(views)))
    other.fitted.fill_(True)
    with pytest.raises(ValueError, match=r"end in the shape \[3, 8, 9\], got \[5, 8"):
        other(views)
    with pytest.raises(ValueError, match=r"shape must be .* channels='CHW' takes"):
        AmortisedExemplars((3, 32, 32))


def test_values_of_stacked_views() -> None:
    def make(channels: str) -> StackedQNetwork:
        return StackedQNetwork(4, size=36, frames=3, hidden=8, channels=channels)

    last, other = both(make)
    views = {POLICY_PIXELS: draw(5, 36, 36, 3), FRAMES: draw(5, 36, 36, 6)}
    wanted = last(TensorDict(views, [5]))
    turned = {key: first(entry) for key, entry in views.items()}
    got = other(TensorDict(turned, [5]))
    torch.testing.assert_close(got[ACTION_VALUE], wanted[ACTION_VALUE])
    assert torch.equal(got["next", FRAMES], first(wanted["next", FRAMES]))
    # The oldest view is gone.
    assert torch.equal(wanted["next", FRAMES][..., :3], views[FRAMES][..., 3:])
    with pytest.raises(ValueError, match="channels='CHW' takes them"):
        last(TensorDict(turned, [5]))
    with pytest.raises(ValueError, match=r"\[36, 36, 9\] with channels='HWC', got"):
        last.convolutions(draw(5, 9, 36, 36))
