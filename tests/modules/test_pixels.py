import pytest
import torch
from torch.nn import functional as F  # noqa: N812

from toponav.modules import ActorCritic, ResNet18, SmallEncoder
from toponav.modules.encoders import check_pixels, compute_dtype, pixels_to_planes
from toponav.modules.policy_trunks import PixelTrunk


def test_planes_are_the_image_scaled_without_moving_a_pixel() -> None:
    image = torch.randint(0, 256, (2, 4, 6, 3), dtype=torch.uint8)
    planes = pixels_to_planes(image, torch.float32)
    assert torch.allclose(planes[1, 2], image[1, :, :, 2] / 255)
    assert planes.is_contiguous(memory_format=torch.channels_last)


def test_float_pixels_keep_their_scale() -> None:
    image = torch.rand(1, 4, 6, 3)
    assert torch.equal(
        pixels_to_planes(image, torch.float32), image.permute(0, 3, 1, 2)
    )


@pytest.mark.parametrize("shape", [(3, 4, 6), (1, 6, 4, 3), (4, 6), (1, 4, 6, 4)])
def test_a_wrong_size_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"shape \[4, 6, 3\] .* got \["):
        check_pixels(torch.zeros(shape, dtype=torch.uint8), (4, 6))


def test_a_wrong_dtype_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must be uint8 .* got torch.int64"):
        check_pixels(torch.zeros(4, 6, 3, dtype=torch.int64), (4, 6))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_float_image_that_is_not_finite_is_refused(value: float) -> None:
    image = torch.zeros(4, 6, 3)
    image[0, 0, 0] = value
    with pytest.raises(ValueError, match="must be finite"):
        check_pixels(image, (4, 6))


@pytest.mark.parametrize(
    ("value", "got"), [(255.0, "0 to 255"), (-1.0, "-1 to 0"), (torch.nan, "nan to")]
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_floats_beyond_0_to_1_are_refused_where_their_scale_counts(
    value: float, got: str, dtype: torch.dtype
) -> None:
    image = torch.zeros(4, 6, 3, dtype=dtype)
    # What TorchRL's RNDTransform makes of bytes: RND normalises its views.
    check_pixels(image + 255, (4, 6))
    image[0, 0, 0] = value
    with pytest.raises(ValueError, match=rf"uint8 or float in 0\.\.1, got {got}"):
        check_pixels(image, (4, 6), unit=True)


def test_what_interpolation_makes_of_an_image_is_none_of_0_to_255() -> None:
    edge = (torch.arange(16.0) > 7).expand(1, 1, 16, 16)
    larger = F.interpolate(edge.float(), (40, 60), mode="bicubic")
    assert larger.max() > 1.05
    check_pixels(larger[0, 0].unsqueeze(-1).expand(-1, -1, 3), (40, 60), unit=True)
    check_pixels(torch.zeros(0, 40, 60, 3), (40, 60), unit=True)


def test_autocast_decides_the_dtype_and_the_weight_otherwise() -> None:
    weight = torch.zeros(1)
    assert compute_dtype(weight) == torch.float32
    assert compute_dtype(weight.double()) == torch.float64
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert compute_dtype(weight) == torch.bfloat16


@pytest.mark.parametrize("network", [SmallEncoder, ResNet18, PixelTrunk])
def test_channels_first_gives_the_same_code(network: type[torch.nn.Module]) -> None:
    last = network(8, image_size=(32, 48)).eval()
    first = network(8, image_size=(32, 48), channels="CHW").eval()
    first.load_state_dict(last.state_dict())
    image = torch.randint(0, 256, (2, 3, 32, 48, 3), dtype=torch.uint8)
    planes = image.movedim(-1, -3).contiguous()
    with torch.no_grad():
        wanted = last(image)
        torch.testing.assert_close(first(planes), wanted, atol=1e-4, rtol=1e-3)
        torch.testing.assert_close(first(planes / 255), wanted, atol=1e-4, rtol=1e-3)
    with pytest.raises(ValueError, match=r"uint8 or float in 0\.\.1, got .* to 25"):
        first(255 * torch.rand(2, 3, 32, 48))
    with pytest.raises(ValueError, match=r"\[3, 32, 48\].*channels='CHW'.* got \[2, 3"):
        first(image)
    with pytest.raises(ValueError, match=r"\('HWC', 'CHW'\), got 'NCHW'"):
        network(8, image_size=(32, 48), channels="NCHW")


def test_the_policy_reads_views_with_channels_first() -> None:
    policy = ActorCritic(num_actions=2, image_size=(20, 24), channels="CHW")
    views = torch.zeros(1, 3, 20, 24, dtype=torch.uint8)
    assert policy.trunk(views).shape == (1, 256)
