"""What all transforms that read views refuse, and in which words."""

from functools import partial

import pytest
import torch
from torchrl.envs import PermuteTransform, TransformedEnv

from tests.fakes import FakeMaze
from toponav.keys import PIXELS
from toponav.transforms import (
    AreaDownsample,
    EmbedViews,
    NoisyTV,
    PolicyPixels,
    WaypointMemory,
)


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


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
@pytest.mark.parametrize("reader", READERS)
def test_channels_first_views_are_refused_with_the_remedy(reader):
    env = make_channels_first()
    assert env.observation_spec[PIXELS].shape == (3, 12, 16)
    message = r"'pixels' must be \[\*B, H, W, C\], got \[3, 12, 16\]; .* Permute.*\("
    with pytest.raises(ValueError, match=message):
        TransformedEnv(env, reader()).observation_spec  # noqa: B018
    remedy = PermuteTransform((-2, -1, -3), in_keys=[PIXELS])
    env = TransformedEnv(TransformedEnv(make_channels_first(), remedy), reader())
    assert env.observation_spec[PIXELS].shape == (12, 16, 3)


def test_the_noisy_tv_refuses_the_other_order_than_it_was_given():
    tv = NoisyTV(size=2, channels="CHW")
    with pytest.raises(
        ValueError, match=r"must be \[\*B, C, H, W\], got \[12, 16, 3\]"
    ):
        TransformedEnv(FakeMaze(), tv).observation_spec  # noqa: B018


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
