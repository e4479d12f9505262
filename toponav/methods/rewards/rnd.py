"""Random network distillation: pays for views that are hard to predict."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.envs.transforms import RNDTransform, Transform
from torchrl.envs.transforms.rnd import RunningMeanStd
from torchrl.modules import MLP, ConvNet
from torchrl.objectives.rnd import RNDLoss

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, RewardConfig, above, at_least, between
from toponav.keys import INTRINSIC_REWARD, POLICY_PIXELS, read_entry
from toponav.modules import check_pixels, start_orthogonal
from toponav.transforms import PolicyPixels
from toponav.views import ChannelOrder, check_order

#: The name under which the networks are published.
_RND = "rnd"
_NEXT_VIEWS: NestedKey = ("next", POLICY_PIXELS)
#: Luma of red, green and blue (ITU-R BT.601).
LUMA = (0.299, 0.587, 0.114)
#: Bound on a normalised pixel, in standard deviations.
_CLIP = 5.0
#: Views converted at once, so that a long rollout needs no float copy of itself.
_CHUNK = 512


class GreyFrames(nn.Module):
    """Grey frames of views, normalised per pixel by all that `update` has counted."""

    luma: Tensor

    def __init__(
        self, image_size: tuple[int, int], channels: ChannelOrder = "HWC"
    ) -> None:
        super().__init__()
        self.image_size = image_size
        self.channels = check_order(channels)
        self.statistics = RunningMeanStd(image_size)
        self.register_buffer("luma", torch.tensor(LUMA) / 255, persistent=False)

    def forward(self, pixels: Tensor) -> Tensor:
        """``[*B, H, W, 3]``, uint8, or as ``channels`` says, to ``[N, 1, H, W]``."""
        frames: Tensor = self.statistics.normalize(self._to_grey(pixels))
        return frames.clamp_(-_CLIP, _CLIP).unsqueeze(1)

    @torch.no_grad()
    def update(self, pixels: Tensor) -> None:
        """Count views, uint8 ``[*B, H, W, 3]``, or as ``channels`` says."""
        for views in pixels.reshape(-1, *pixels.shape[-3:]).split(_CHUNK):
            self.statistics.update(self._to_grey(views))

    def _to_grey(self, pixels: Tensor) -> Tensor:
        pixels = check_pixels(pixels, self.image_size, channels=self.channels)
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
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, 3, H, W]``.

    Examples:
        >>> rnd = RandomNetworkDistillation((84, 84), width=8, feature_dim=64)
        >>> views = torch.randint(256, (5, 84, 84, 3), dtype=torch.uint8)
        >>> rnd.update(views)
        >>> error = (rnd.predictor(views) - rnd.target(views)).square().mean(-1)
        >>> error.shape
        torch.Size([5])
    """

    def __init__(
        self,
        image_size: tuple[int, int],
        *,
        width: int = 32,
        feature_dim: int = 512,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        frames = GreyFrames(image_size, channels)
        target = FrameNetwork(image_size, width, feature_dim, num_hidden=0)
        predictor = FrameNetwork(image_size, width, feature_dim, num_hidden=2)
        self.target = ViewFeatures(frames, target).requires_grad_(False)
        self.predictor = ViewFeatures(frames, predictor)

    def update(self, pixels: Tensor) -> None:
        """Count views for both networks, as `GreyFrames.update`."""
        self.predictor.frames.update(pixels)


@dataclass
class RNDConfig(RewardConfig):
    """Settings of ``reward=rnd``."""

    lr: float = above(0)
    width: int = at_least(1)
    feature_dim: int = at_least(1)
    update_fraction: float = between(0.001, 1)
    minibatches: int = at_least(1)


class RNDMethod(RewardMethod):
    """The error with which a network predicts the features of a fixed random one.

    TorchRL's ``RNDTransform`` computes it in the collecting processes, by the newest
    networks and statistics; its ``RNDLoss`` trains the predictor here, on each batch.
    The learner's ``normalize_returns`` scales the reward as in the paper. Unlike there,
    views are counted for normalisation from the first batch on and not before it, and
    an episode's end ends the return.
    """

    schema = RNDConfig
    config: RNDConfig
    # The error of any view falls while the predictor learns.
    selection_metric = None
    reward_key = INTRINSIC_REWARD
    in_keys = (_NEXT_VIEWS,)
    saved = ("rnd", "optimizer")

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        config = self.config
        self.policy_sees_pixels = settings.policy.input == "pixels"
        self.view_size = (settings.policy.view_size, settings.policy.view_size)
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.rnd = RandomNetworkDistillation(
                self.view_size, width=config.width, feature_dim=config.feature_dim
            )
        self.loss = RNDLoss(self.rnd.predictor, self.rnd.target, update_fraction=1.0)
        self.loss.set_keys(observation=POLICY_PIXELS)
        self.optimizer = torch.optim.Adam(self.rnd.predictor.parameters(), lr=config.lr)

    def modules(self) -> dict[str, nn.Module]:
        return {_RND: self.rnd}

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        views: list[Transform] = []
        if not self.policy_sees_pixels:
            views.append(PolicyPixels(size=self.view_size))
        reward = RNDTransform(
            self.rnd.target,
            self.rnd.predictor,
            in_keys=[POLICY_PIXELS],
            out_keys=[INTRINSIC_REWARD],
            normalize_obs=False,
            normalize_reward=False,
        )
        return [*views, reward]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Count the views of a batch, and train the predictor on a part of them."""
        views = read_entry(batch, _NEXT_VIEWS).flatten(0, 1)
        self.rnd.update(views)
        losses = []
        # TorchRL's own update_fraction computes every view, and then leaves some out.
        num_trained = max(round(self.config.update_fraction * len(views)), 1)
        rows = torch.randperm(len(views))[:num_trained]
        for piece in rows.chunk(self.config.minibatches):
            frames = TensorDict({POLICY_PIXELS: views[piece]}, [len(piece)])
            loss = self.loss(frames)["loss_predictor"]
            self.optimizer.zero_grad()
            loss.backward()
            self.optimizer.step()
            losses.append(float(loss.detach()))
        return {"loss_predictor": sum(losses) / len(losses)}
