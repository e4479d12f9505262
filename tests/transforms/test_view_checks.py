"""What all transforms that read views refuse, and in which words."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import PermuteTransform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.fakes import FakeMaze
from toponav.keys import PIXELS
from toponav.transforms import (
    AreaDownsample,
    EmbedViews,
    NoisyTV,
    PolicyPixels,
    WaypointMemory,
)
from toponav.views import check_views


def embed(views):
    return views.flatten(1).float()


def compare(one, many):
    return (one.unsqueeze(1) - many).abs().mean(-1) * 0


READERS = [
    AreaDownsample,
    partial(NoisyTV, size=2),
    partial(PolicyPixels, (4, 4)),
    partial(WaypointMemory, embed, compare),
    partial(EmbedViews, embed, in_keys=[PIXELS]),
]


def make_channels_first():
    return TransformedEnv(FakeMaze(), PermuteTransform((-1, -3, -2), in_keys=[PIXELS]))


@pytest.mark.parametrize("reader", READERS)
def test_each_order_refuses_the_other_and_says_what_takes_it(reader):
    message = (
        r"'pixels' must be \[\*B, H, W, C\] with channels='HWC', got \[3, 12, 16\]; "
        "channels='CHW' takes them"
    )
    with pytest.raises(ValueError, match=message):
        TransformedEnv(make_channels_first(), reader()).observation_spec  # noqa: B018
    message = r"\[\*B, C, H, W\] .*got \[12, 16, 3\]; channels='HWC' takes"
    with pytest.raises(ValueError, match=message):
        TransformedEnv(FakeMaze(), reader(channels="CHW")).observation_spec  # noqa: B018
    with pytest.raises(ValueError, match=r"one of \('HWC', 'CHW'\), got 'WHC'"):
        reader(channels="WHC")


@pytest.mark.parametrize("reader", READERS)
def test_data_without_an_env_is_checked_too(reader):
    data = TensorDict({PIXELS: torch.zeros(2, 3, 12, 16)}, [2])
    with pytest.raises(ValueError, match=r"\[2, 3, 12, 16\]; channels='CHW' takes"):
        reader()._reset(data.empty(), data)


def see(env, order):
    """What a transform wrote of a walk, with channels last."""
    env.set_seed(0)
    torch.manual_seed(0)
    walk = env.rollout(4)["next"].exclude("privileged", "action")
    names = [name for name in walk.keys(True, True) if "pixels" in name]
    if order == "CHW":
        for name in names:
            walk[name] = walk[name].movedim(-3, -1)
    return walk


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
@pytest.mark.parametrize("reader", READERS)
def test_channels_first_gives_what_channels_last_gives(reader):
    options = {"seed": 0} if getattr(reader, "func", None) is NoisyTV else {}
    last = TransformedEnv(FakeMaze(), reader(**options))
    first, again = (
        TransformedEnv(make_channels_first(), reader(channels="CHW", **options))
        for _ in range(2)
    )
    check_env_specs(again)
    wanted, got = see(last, "HWC"), see(first, "CHW")
    assert set(got.keys(True, True)) == set(wanted.keys(True, True))
    for name in wanted.keys(True, True):
        assert got[name].shape == wanted[name].shape, name
        if name != "embedding":  # the callable saw the other order
            assert torch.equal(got[name], wanted[name]), name


@pytest.mark.parametrize("size", [(1, 1), (3, 4), (4, 3)])
def test_small_images_are_not_taken_for_channels_first(size):
    env = TransformedEnv(FakeMaze(image_size=size), AreaDownsample(factor=1))
    assert env.observation_spec["network_pixels"].shape == (*size, 3)


@pytest.mark.parametrize("reader", READERS)
def test_a_missing_view_is_named(reader):
    env = FakeMaze()
    data = env.reset().exclude(PIXELS)
    with pytest.raises((ValueError, KeyError), match="pixels"):
        reader()._reset(data.empty(), data)


def test_embeddings_of_a_network_are_not_its_weights():
    class Scale(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.scale = torch.nn.Parameter(torch.ones(1))

        def forward(self, views):
            return views.float().mean((1, 2)) * self.scale

    network = Scale()
    transform = EmbedViews(network, in_keys=[PIXELS])
    assert not list(transform.parameters())
    env = TransformedEnv(FakeMaze(batch_size=[2]), transform)
    before = env.reset()
    assert not before["embedding"].requires_grad
    assert torch.equal(before["embedding"], network(before[PIXELS]))
    with torch.no_grad():
        network.scale.fill_(2.0)
    after = env.rand_step(before)["next"]
    assert torch.equal(after["embedding"], after[PIXELS].float().mean((1, 2)) * 2)


def test_nothing_but_the_noisy_tv_writes_over_its_views():
    made = [reader() for reader in READERS]
    over = [one for one in made if set(one.in_keys) & set(one.out_keys)]
    assert [type(one) for one in over] == [NoisyTV]


@pytest.mark.parametrize("count", [2, 6, 9, 12])
def test_stacks_of_frames_in_the_other_order_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match="channels='CHW' takes them"):
        check_views("pixels", (5, count, 84, 84), "HWC")
    with pytest.raises(ValueError, match="channels='HWC' takes them"):
        check_views("pixels", (5, 84, 84, count), "CHW")
    check_views("pixels", (5, 84, 84, count), "HWC")
    check_views("pixels", (5, count, 84, 84), "CHW")
