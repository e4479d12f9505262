import copy

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.nn import functional as F  # noqa: N812
from torch.utils.flop_counter import FlopCounterMode

from toponav.modules import ResNet18, SmallEncoder
from toponav.modules.encoders import box_downsample
from toponav.modules.folding import FoldCache


def pixels(*batch: int) -> torch.Tensor:
    return torch.randint(0, 256, (*batch, 24, 32, 3), dtype=torch.uint8)


def make_encoder(*, batch_norm: bool = True) -> SmallEncoder:
    return SmallEncoder(16, batch_norm=batch_norm, image_size=(24, 32))


def count_flop(encoder: nn.Module) -> int:
    counter = FlopCounterMode(display=False)
    with counter:
        encoder(torch.zeros(1, 120, 160, 3, dtype=torch.uint8))
    return int(counter.get_total_flops())


def test_it_is_at_least_ten_times_cheaper_than_resnet() -> None:
    small = SmallEncoder(image_size=(120, 160)).eval()
    large = ResNet18(image_size=(120, 160)).eval()
    # 2 * (30*40*32*75 + 15*20*48*288 + 8*10*64*432 + 4*5*96*576 + 1920*256)
    assert count_flop(small) == 21_672_960
    assert count_flop(large) > 10 * count_flop(small)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_the_box_is_the_mean_of_four_pixels(dtype: torch.dtype) -> None:
    image = pixels(3)
    given = image if dtype == torch.uint8 else image.float() / 255
    expected = F.avg_pool2d(image.permute(0, 3, 1, 2).float() / 255, 2)
    planes = box_downsample(given, torch.float32)
    assert torch.allclose(planes, expected, atol=1e-6)
    assert planes.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("batch_norm", [True, False])
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_any_batch_shape_is_kept(batch: tuple[int, ...], batch_norm: bool) -> None:
    encoder = make_encoder(batch_norm=batch_norm).eval()
    assert encoder(pixels(*batch)).shape == (*batch, 16)


def test_batch_norm_is_a_choice() -> None:
    def count(encoder: nn.Module) -> int:
        return sum(isinstance(m, nn.BatchNorm2d) for m in encoder.modules())

    assert count(make_encoder(batch_norm=True)) == 4
    assert count(make_encoder(batch_norm=False)) == 0


@pytest.mark.parametrize("batch_norm", [True, False])
def test_gradients_reach_every_parameter(batch_norm: bool) -> None:
    encoder = make_encoder(batch_norm=batch_norm)
    encoder(pixels(8)).square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_bfloat16_stays_close() -> None:
    encoder = make_encoder().eval()
    image = pixels(4)
    exact = encoder(image)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rough = encoder(image)
    assert rough.dtype == torch.bfloat16
    # bfloat16 keeps 8 bits, and five layers add up.
    assert (rough - exact).norm() / exact.norm() < 0.02


def test_a_halved_view_gives_the_same_up_to_rounding() -> None:
    encoder, full = make_encoder().eval(), pixels(6)
    planes = full.permute(0, 3, 1, 2).float()
    exact = F.avg_pool2d(planes, 2).permute(0, 2, 3, 1)
    # Floats that were not rounded give the same embedding, bytes nearly.
    assert torch.allclose(encoder(exact / 255), encoder(full), atol=1e-5)
    rounded = encoder(exact.round().to(torch.uint8))
    assert (rounded - encoder(full)).norm() / encoder(full).norm() < 0.01


def test_a_copy_and_a_loaded_network_give_the_same() -> None:
    encoder, loaded = make_encoder().eval(), make_encoder().eval()
    loaded.load_state_dict(encoder.state_dict())
    image = pixels(2)
    assert torch.equal(loaded(image), encoder(image))
    assert torch.equal(copy.deepcopy(encoder)(image), encoder(image))


def test_an_odd_size_and_a_wrong_image_are_refused() -> None:
    with pytest.raises(ValueError, match=r"image_size must be even, got \(23, 32\)"):
        SmallEncoder(image_size=(23, 32))
    with pytest.raises(ValueError, match=r"shape \[24, 32, 3\] or \[12, 16, 3\]"):
        make_encoder()(torch.zeros(1, 3, 24, 32, dtype=torch.uint8))
    with pytest.raises(ValueError, match="must be uint8"):
        make_encoder()(torch.zeros(1, 24, 32, 3, dtype=torch.int32))


@pytest.mark.parametrize("batch_norm", [True, False])
def test_folding_the_normalisation_changes_no_embedding(batch_norm: bool) -> None:
    torch.manual_seed(0)
    encoder = SmallEncoder(32, batch_norm=batch_norm, image_size=(120, 160))
    views = torch.randint(0, 256, (6, 120, 160, 3), dtype=torch.uint8)
    for _ in range(3):
        encoder(views)  # moves the running means and variances
    for layer in encoder.convolutions:
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.weight.data.uniform_(0.5, 2)
            layer.bias.data.uniform_(-1, 1)
    encoder.eval()
    plain = encoder(views)
    with torch.no_grad():
        folded = encoder(views)
    assert plain.requires_grad
    assert not folded.requires_grad
    torch.testing.assert_close(folded, plain.detach(), rtol=1e-4, atol=1e-5)


def embed_plainly(encoder: SmallEncoder, views: torch.Tensor) -> torch.Tensor:
    """With the normalisation apart: where there are gradients, nothing is folded."""
    return encoder(views).detach()


@torch.no_grad()
def change_weight(encoder: SmallEncoder) -> None:
    encoder.convolutions[0].weight.mul_(2)


def load_others(encoder: SmallEncoder) -> None:
    encoder.load_state_dict(make_encoder().state_dict())


def exchange_weight(encoder: SmallEncoder) -> None:
    layer = encoder.convolutions[3]
    version = layer.weight._version
    layer.weight.data = layer.weight.detach() * 2
    assert layer.weight._version == version


def double_by_data(encoder: SmallEncoder) -> None:
    encoder.convolutions[3].weight.data.mul_(2)


def shift_by_data(encoder: SmallEncoder) -> None:
    encoder.convolutions[1].running_mean.data.add_(1)


def receive_weights(encoder: SmallEncoder) -> None:
    """As TorchRL's collectors do."""
    sent = TensorDict.from_module(make_encoder()).data
    TensorDict.from_module(encoder).data.update_(sent)


def train_statistics(encoder: SmallEncoder) -> None:
    with torch.no_grad():
        encoder.train()(pixels(8))
    encoder.eval()


@pytest.mark.parametrize(
    "change",
    [
        change_weight,
        load_others,
        exchange_weight,
        train_statistics,
        double_by_data,
        shift_by_data,
        receive_weights,
    ],
)
def test_a_fold_is_never_stale(change) -> None:
    encoder, views = make_encoder().eval(), pixels(2)
    with torch.no_grad():
        before = encoder(views)
        # The second one has nothing to fold.
        torch.testing.assert_close(encoder(views), before)
    change(encoder)
    with torch.no_grad():
        after = encoder(views)
    assert not torch.allclose(after, before, atol=1e-3)
    expected = embed_plainly(encoder, views)
    torch.testing.assert_close(after, expected, rtol=1e-4, atol=1e-5)


def test_weights_that_another_process_changes_are_not_stale() -> None:
    encoder, views = make_encoder().eval().share_memory(), pixels(2)
    with torch.no_grad():
        encoder(views)
    shared = encoder.convolutions[0].weight
    # Another tensor over the same memory: the module's own version stays.
    version = shared._version
    torch.from_numpy(shared.detach().numpy()).mul_(3)
    assert shared._version == version
    with torch.no_grad():
        after = encoder(views)
    expected = embed_plainly(encoder, views)
    torch.testing.assert_close(after, expected, rtol=1e-4, atol=1e-5)


def test_memory_that_is_used_again_is_not_taken_for_what_was_there() -> None:
    cache, layer, made = FoldCache(), nn.Linear(64, 64, bias=False), []
    for _ in range(10):
        # The second one finds the memory that the one before has left.
        for _ in range(2):
            layer.weight = nn.Parameter(torch.rand(64, 64))
        cache.get(lambda: made.append(1) or [], layer)
    assert len(made) == 10


@pytest.mark.parametrize(("is_cpu", "times"), [(True, 2), (False, 1)])
def test_a_gpu_folds_once(
    is_cpu: bool, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of a GPU torch calls all tensors shared.
    monkeypatch.setattr(torch.Tensor, "is_shared", lambda tensor: True)
    monkeypatch.setattr(torch.Tensor, "is_cpu", is_cpu)
    cache, layer, made = FoldCache(), torch.nn.Linear(2, 2), []
    for _ in range(2):
        cache.get(lambda: made.append(1) or [], layer)
    assert len(made) == times


def test_a_copy_folds_its_own_weights() -> None:
    encoder, views = make_encoder().eval(), pixels(2)
    with torch.no_grad():
        encoder(views)
        copied = copy.deepcopy(encoder)
        change_weight(copied)
        after = copied(views)
    expected = embed_plainly(copied, views)
    torch.testing.assert_close(after, expected, rtol=1e-4, atol=1e-5)
