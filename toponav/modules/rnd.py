"""`RandomNetworkDistillation`: the networks of TorchRL's RND, for views."""

import torch
from torch import Tensor, nn
from torchrl.envs.transforms.rnd import RunningMeanStd
from torchrl.modules import MLP, ConvNet

from toponav.modules.pixels import check_pixels, start_orthogonal

#: Luma of red, green and blue (ITU-R BT.601).
_LUMA = (0.299, 0.587, 0.114)
#: Bound on a normalised pixel, in standard deviations.
_CLIP = 5.0
#: Views converted at once, so that a long rollout needs no float copy of itself.
_CHUNK = 512


class GreyFrames(nn.Module):
    """Grey frames of views, normalised per pixel by all that `update` has counted."""

    luma: Tensor

    def __init__(self, image_size: tuple[int, int]) -> None:
        super().__init__()
        self.image_size = image_size
        self.statistics = RunningMeanStd(image_size)
        self.register_buffer("luma", torch.tensor(_LUMA) / 255, persistent=False)

    def forward(self, pixels: Tensor) -> Tensor:
        """``[*B, H, W, 3]``, uint8 or float in 0..255, to ``[N, 1, H, W]``."""
        frames: Tensor = self.statistics.normalize(self._to_grey(pixels))
        return frames.clamp_(-_CLIP, _CLIP).unsqueeze(1)

    @torch.no_grad()
    def update(self, pixels: Tensor) -> None:
        for views in pixels.reshape(-1, *pixels.shape[-3:]).split(_CHUNK):
            self.statistics.update(self._to_grey(views))

    def _to_grey(self, pixels: Tensor) -> Tensor:
        check_pixels(pixels, self.image_size)
        return pixels.reshape(-1, *pixels.shape[-3:]).float() @ self.luma


class FrameNetwork(nn.Module):
    """Three convolutions and ``num_hidden + 1`` linear layers over grey frames."""

    def __init__(
        self, image_size: tuple[int, int], width: int, feature_dim: int, num_hidden: int
    ) -> None:
        super().__init__()
        if min(image_size) < 36:
            raise ValueError(
                f"image_size must be at least 36 both ways, got {image_size}."
            )
        convolutions = ConvNet(
            in_features=1,
            num_cells=[width, 2 * width, 2 * width],
            kernel_sizes=[8, 4, 3],
            strides=[4, 2, 1],
            # The slope that Burda et al.'s code has by TensorFlow's default.
            activation_class=nn.LeakyReLU,
            activation_kwargs={"negative_slope": 0.2, "inplace": True},
        )
        inputs = convolutions(torch.zeros(1, 1, *image_size)).shape[-1]
        hidden = [feature_dim] * num_hidden
        head = MLP(inputs, feature_dim, num_cells=hidden, activation_class=nn.ReLU)
        self.layers = nn.Sequential(*convolutions, *head)
        for layer in self.layers:
            if isinstance(layer, nn.Conv2d | nn.Linear):
                start_orthogonal(layer)

    def forward(self, frames: Tensor) -> Tensor:
        features: Tensor = self.layers(frames)
        return features


class ViewFeatures(nn.Module):
    """Features of views, ``[*B, H, W, 3]`` to ``[*B, D]``."""

    def __init__(self, frames: GreyFrames, network: FrameNetwork) -> None:
        super().__init__()
        self.frames = frames
        self.network = network

    def forward(self, pixels: Tensor) -> Tensor:
        features: Tensor = self.network(self.frames(pixels))
        return features.reshape(*pixels.shape[:-3], -1)


class RandomNetworkDistillation(nn.Module):
    """A fixed random network of views and one that learns to predict its features.

    Hand ``target`` and ``predictor`` to TorchRL's ``RNDTransform``, which pays the
    error of the prediction, and to its ``RNDLoss``, which reduces it. Both normalise
    the views themselves, by statistics that `update` alone changes and ``state_dict``
    holds: switch the transform's own normalisation off.

    Reference:
        Burda et al., "Exploration by Random Network Distillation" (2018), section 2
        and appendix A.3; the default widths are theirs.

    Args:
        image_size: height and width of the views in pixels, at least 36 each.
        width: channels of the first convolution.
        feature_dim: length of the features.

    Examples:
        >>> rnd = RandomNetworkDistillation((84, 84), width=8, feature_dim=64)
        >>> views = torch.randint(256, (5, 84, 84, 3), dtype=torch.uint8)
        >>> rnd.update(views)
        >>> error = (rnd.predictor(views) - rnd.target(views)).square().mean(-1)
        >>> error.shape
        torch.Size([5])
    """

    def __init__(
        self, image_size: tuple[int, int], *, width: int = 32, feature_dim: int = 512
    ) -> None:
        super().__init__()
        frames = GreyFrames(image_size)
        target = FrameNetwork(image_size, width, feature_dim, num_hidden=0)
        predictor = FrameNetwork(image_size, width, feature_dim, num_hidden=2)
        self.target = ViewFeatures(frames, target).requires_grad_(False)
        self.predictor = ViewFeatures(frames, predictor)

    def update(self, pixels: Tensor) -> None:
        self.predictor.frames.update(pixels)
