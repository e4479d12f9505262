import copy
import pickle

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from toponav.modules import ResNet18


@pytest.fixture(scope="module")
def encoder() -> ResNet18:
    torch.manual_seed(0)
    return ResNet18(image_size=(24, 32)).eval()


def pixels(*batch: int) -> torch.Tensor:
    return torch.randint(0, 256, (*batch, 24, 32, 3), dtype=torch.uint8)


def test_it_has_the_parameters_and_flop_of_the_paper() -> None:
    encoder = ResNet18(image_size=(120, 160)).eval()
    counter = FlopCounterMode(display=False)
    with counter:
        encoder(torch.zeros(1, 120, 160, 3, dtype=torch.uint8))
    # ResNet-18 has 11,689,512 parameters, its last layer 512 * 1000 + 1000 of them.
    assert sum(p.numel() for p in encoder.parameters()) == 11_176_512
    assert counter.get_total_flops() == pytest.approx(1.430e9, rel=1e-3)


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_any_batch_shape_is_kept(encoder: ResNet18, batch: tuple[int, ...]) -> None:
    assert encoder(pixels(*batch)).shape == (*batch, 512)


def test_batch_shape_does_not_change_the_embedding(encoder: ResNet18) -> None:
    image = pixels(2, 3)
    flat = encoder(image.flatten(0, 1))
    assert torch.allclose(encoder(image).flatten(0, 1), flat, atol=1e-6)


def test_uint8_and_float_pixels_agree(encoder: ResNet18) -> None:
    image = pixels(2)
    assert torch.allclose(encoder(image), encoder(image.float() / 255), atol=1e-5)


def test_another_embedding_length_adds_a_layer() -> None:
    encoder = ResNet18(64, image_size=(24, 32)).eval()
    assert encoder(pixels(2)).shape == (2, 64)


def test_bfloat16_stays_close(encoder: ResNet18) -> None:
    image = pixels(4)
    exact = encoder(image)
    rough = copy.deepcopy(encoder).to(torch.bfloat16)(image)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = encoder(image)
    assert rough.dtype == cast.dtype == torch.bfloat16
    # bfloat16 keeps 8 bits; the errors of 18 layers average out to about 1 %.
    for close in (rough, cast):
        assert (close - exact).norm() / exact.norm() < 0.02


def test_gradients_reach_every_parameter() -> None:
    encoder = ResNet18(image_size=(24, 32))
    encoder(pixels(4)).square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_a_copy_and_a_loaded_network_give_the_same(
    encoder: ResNet18, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("resnet") / "encoder.pt"
    torch.save(encoder.state_dict(), path)
    loaded = ResNet18(image_size=(24, 32)).eval()
    loaded.load_state_dict(torch.load(path, weights_only=True))
    image = pixels(2)
    assert torch.equal(loaded(image), encoder(image))
    assert torch.equal(copy.deepcopy(encoder)(image), encoder(image))


def test_weights_lie_in_channels_last_order(encoder: ResNet18) -> None:
    for copied in (encoder, copy.deepcopy(encoder).to(torch.bfloat16)):
        for layer in copied.modules():
            if isinstance(layer, nn.Conv2d) and layer.kernel_size != (1, 1):
                assert layer.weight.is_contiguous(memory_format=torch.channels_last)


def test_a_wrong_image_is_refused(encoder: ResNet18) -> None:
    with pytest.raises(ValueError, match=r"must end in the shape \[24, 32, 3\]"):
        encoder(torch.zeros(1, 32, 24, 3, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"float in 0\.\.1, got nan to nan"):
        encoder(torch.full((1, 24, 32, 3), torch.nan))


def make_worn_encoder() -> ResNet18:
    """With statistics, scales and shifts as after training."""
    torch.manual_seed(0)
    encoder = ResNet18(image_size=(24, 32))
    for _ in range(3):
        encoder(pixels(4))
    for layer in encoder.modules():
        if isinstance(layer, nn.BatchNorm2d):
            nn.init.uniform_(layer.weight, 0.5, 1.5)
            nn.init.uniform_(layer.bias, -0.5, 0.5)
    return encoder.eval()


def embed_plainly(encoder: ResNet18, views: torch.Tensor) -> torch.Tensor:
    """With the normalisation apart: where there are gradients, nothing is folded."""
    with torch.enable_grad():
        return encoder(views).detach()


@pytest.mark.parametrize("has_onednn", [True, False])
def test_folding_and_packing_change_no_embedding(
    has_onednn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_onednn:
        monkeypatch.setattr("torch.backends.mkldnn.is_available", lambda: False)
    encoder = make_worn_encoder()
    for views in (pixels(1), pixels(5), pixels(5)):
        with torch.no_grad():
            folded = encoder(views)
        expected = embed_plainly(encoder, views)
        torch.testing.assert_close(folded, expected, rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_folds_are_never_stale_and_copies_have_their_own() -> None:
    encoder, views = make_worn_encoder(), pixels(3)
    before = encoder(views)
    others = [copy.deepcopy(encoder), pickle.loads(pickle.dumps(encoder))]
    encoder.blocks[3].norm2.running_mean.add_(1)
    encoder.stem.weight.data = encoder.stem.weight * 2
    encoder.blocks[0].conv1.weight.data.mul_(3)
    assert not torch.allclose(encoder(views), before, atol=1e-2)
    expected = embed_plainly(encoder, views)
    torch.testing.assert_close(encoder(views), expected, rtol=1e-3, atol=1e-4)
    for other in others:
        torch.testing.assert_close(other(views), before, rtol=1e-4, atol=1e-5)
        other.bfloat16()
        torch.testing.assert_close(other(views).float(), before, rtol=0.1, atol=0.1)
