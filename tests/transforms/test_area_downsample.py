from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F  # noqa: N812
from torchrl.envs import TransformedEnv

from tests.checks import check_parallel, check_transform
from tests.fakes import FakeMaze
from toponav.keys import NETWORK_PIXELS, PIXELS
from toponav.transforms import AreaDownsample


def make_env(batch_size=(), *, image_size=(12, 16), float_pixels=False):
    return FakeMaze(
        batch_size=batch_size,
        image_size=image_size,
        max_decisions=5,
        float_pixels=float_pixels,
    )


def shrink(views, factor):
    data = TensorDict({PIXELS: views}, batch_size=views.shape[:1])
    return AreaDownsample(factor=factor)(data)[NETWORK_PIXELS]


def test_worked_numbers():
    # Means 3 / 4 and 2 / 4, rounded to the nearest, halves up; then 255.
    image = torch.tensor([[0, 1, 0, 1, 255, 255], [1, 1, 0, 1, 255, 255]])
    views = image.to(torch.uint8).reshape(1, 2, 6, 1)
    assert shrink(views, 2).flatten().tolist() == [1, 1, 255]


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 12])
def test_it_is_the_rounded_area_mean(factor):
    views = torch.randint(0, 256, (5, 12, 24, 3), dtype=torch.uint8)
    planes = views.permute(0, 3, 1, 2).double()
    mean = F.avg_pool2d(planes, factor).permute(0, 2, 3, 1)
    small = shrink(views, factor)
    assert small.dtype == torch.uint8
    assert small.shape == (5, 12 // factor, 24 // factor, 3)
    assert torch.equal(small.double(), (mean + 0.5).floor())


def test_floats_are_averaged_without_rounding():
    views = torch.rand(2, 4, 6, 3)
    mean = F.avg_pool2d(views.permute(0, 3, 1, 2), 2).permute(0, 2, 3, 1)
    assert torch.allclose(shrink(views, 2), mean, atol=1e-6)


@pytest.mark.parametrize("float_pixels", [True, False])
def test_the_specs_hold_in_every_place(float_pixels):
    check_transform(partial(make_env, float_pixels=float_pixels), AreaDownsample)


@pytest.mark.slow
def test_the_specs_hold_in_spawned_workers():
    check_parallel(make_env, AreaDownsample)


def test_the_full_view_stays_under_another_key():
    env = TransformedEnv(make_env(), AreaDownsample())
    views = env.rollout(2)
    assert views[PIXELS].shape[-3:] == (12, 16, 3)
    assert views[NETWORK_PIXELS].shape[-3:] == (6, 8, 3)


def test_factor_one_hands_the_view_on():
    env = TransformedEnv(make_env(), AreaDownsample(factor=1))
    views = env.rollout(2)
    assert torch.equal(views[NETWORK_PIXELS], views[PIXELS])


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="factor must be at least 1, got 0"):
        AreaDownsample(factor=0)
    with pytest.raises(ValueError, match="multiples of 5"):
        _ = TransformedEnv(make_env(), AreaDownsample(factor=5)).observation_spec
    with pytest.raises(ValueError, match="'view' must be an observation of the env"):
        _ = TransformedEnv(make_env(), AreaDownsample(["view"])).observation_spec
