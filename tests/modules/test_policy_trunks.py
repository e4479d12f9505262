import pytest
import torch
from torch.nn import functional as F  # noqa: N812

from toponav.modules.policy_trunks import EmbeddingTrunk, PixelTrunk


def test_bytes_and_floats_of_the_same_image_give_the_same_code() -> None:
    trunk = PixelTrunk(8, image_size=(84, 84))
    pixels = torch.randint(256, (2, 3, 84, 84, 3), dtype=torch.uint8)
    code = trunk(pixels)
    assert code.shape == (2, 3, 8)
    torch.testing.assert_close(code, trunk(pixels / 255), atol=1e-5, rtol=1e-4)


def test_it_is_the_paper_s_stack_of_layers() -> None:
    trunk = PixelTrunk(8, image_size=(84, 84))
    pixels = torch.randint(256, (2, 84, 84, 3), dtype=torch.uint8)
    hidden = pixels.permute(0, 3, 1, 2).float() / 255
    hidden = F.relu(trunk.conv1(hidden))
    assert hidden.shape == (2, 16, 20, 20)
    hidden = F.relu(trunk.conv2(hidden))
    assert hidden.shape == (2, 32, 9, 9)
    expected = F.relu(trunk.project(hidden.permute(0, 2, 3, 1).flatten(1)))
    torch.testing.assert_close(trunk(pixels), expected, atol=1e-5, rtol=1e-4)


def test_every_layer_of_the_pixels_learns() -> None:
    trunk = PixelTrunk(8, image_size=(84, 84))
    trunk(torch.randint(256, (2, 84, 84, 3), dtype=torch.uint8)).sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in trunk.parameters())


def test_no_gradient_enters_the_embedding() -> None:
    embedding = torch.randn(4, 8, requires_grad=True)
    trunk = EmbeddingTrunk(8, 5)
    trunk(embedding).sum().backward()
    assert embedding.grad is None
    assert trunk.project.weight.grad is not None


def test_an_embedding_of_another_dtype_is_read() -> None:
    trunk = EmbeddingTrunk(8, 5)
    embedding = torch.randn(4, 8).bfloat16()
    torch.testing.assert_close(trunk(embedding), trunk(embedding.float()))


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"at least 20 both ways, got \(19, 84\)"):
        PixelTrunk(image_size=(19, 84))
    with pytest.raises(ValueError, match=r"shape \[84, 84, 3\].*got \[2, 84, 80, 3\]"):
        PixelTrunk(image_size=(84, 84))(torch.zeros(2, 84, 80, 3, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"length 8, got \[2, 9\]"):
        EmbeddingTrunk(8)(torch.zeros(2, 9))


def test_the_smallest_image_that_is_accepted_works() -> None:
    pixels = torch.zeros(1, 20, 20, 3, dtype=torch.uint8)
    assert PixelTrunk(4, image_size=(20, 20))(pixels).shape == (1, 4)
