"""TorchRL transforms of the surroundings, each usable in any TorchRL project."""

from toponav.transforms.area_downsample import AreaDownsample
from toponav.transforms.coverage import Coverage
from toponav.transforms.noisy_tv import NOISE_LAWS, NoiseLaw, NoisyTV

__all__ = ["NOISE_LAWS", "AreaDownsample", "Coverage", "NoiseLaw", "NoisyTV"]
