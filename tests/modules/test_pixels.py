import pytest
import torch

from toponav.modules.encoders import check_pixels, compute_dtype, pixels_to_planes


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


def test_autocast_decides_the_dtype_and_the_weight_otherwise() -> None:
    weight = torch.zeros(1)
    assert compute_dtype(weight) == torch.float32
    assert compute_dtype(weight.double()) == torch.float64
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert compute_dtype(weight) == torch.bfloat16
