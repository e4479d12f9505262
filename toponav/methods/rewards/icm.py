"""Intrinsic curiosity: pays for views that an action leads to unforeseen."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import torch
from omegaconf import MISSING
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torch.nn.utils import clip_grad_norm_
from torchrl.envs.transforms import Transform

from toponav.actions import as_numbers
from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, RewardConfig, above, at_least, between
from toponav.keys import ACTION, FRAME_STACK, INTRINSIC_REWARD, read_entry
from toponav.methods.rewards.bonus_reward import BonusReward
from toponav.methods.rewards.grey_stack import GreyStack
from toponav.parts import require_callables
from toponav.views import ChannelOrder, channels_last, check_order

#: The name under which the networks are published.
_ICM = "icm"
_NEXT_STACK: NestedKey = ("next", FRAME_STACK)
#: Convolutions of the encoder, channels of each, and width of the other layers.
_CONVOLUTIONS, _WIDTH, _HIDDEN = 4, 32, 256


class IntrinsicCuriosity(nn.Module):
    """Features of views, a model that predicts them, and one that names the action.

    The inverse model tells from the features of two successive views which action was
    taken, so that they hold what actions change. The forward model predicts the later
    features from the earlier ones and the action.

    Reference:
        Pathak et al., "Curiosity-driven Exploration by Self-supervised Prediction"
        (2017), section 2.2; sizes and first weights are those of their code.

    Args:
        num_actions: number A of actions.
        size: height and width of the views in pixels.
        frames: number K of views in a stack.
        channels: ``"HWC"``, or ``"CHW"`` for stacks ``[*B, K, H, W]``.
        forward_trains_features: whether the forward model's error reaches the features,
            as in the authors' code; if not, the inverse model alone trains them.

    Examples:
        >>> icm = IntrinsicCuriosity(6)
        >>> stacks = torch.randint(256, (2, 5, 42, 42, 4), dtype=torch.uint8)
        >>> logits, error = icm(stacks[0], torch.zeros(5, dtype=torch.int64), stacks[1])
        >>> logits.shape, error.shape
        (torch.Size([5, 6]), torch.Size([5]))
    """

    def __init__(
        self,
        num_actions: int,
        *,
        size: tuple[int, int] = (42, 42),
        frames: int = 4,
        channels: ChannelOrder = "HWC",
        forward_trains_features: bool = True,
    ) -> None:
        super().__init__()
        self.num_actions = num_actions
        self.channels = check_order(channels)
        self.stack_shape = (*size, frames) if channels == "HWC" else (frames, *size)
        self.forward_trains_features = forward_trains_features
        layers: list[nn.Module] = []
        for planes, width in pairwise([frames] + [_WIDTH] * _CONVOLUTIONS):
            convolution = nn.Conv2d(planes, width, 3, stride=2, padding=1)
            nn.init.xavier_uniform_(convolution.weight)
            assert convolution.bias is not None
            nn.init.zeros_(convolution.bias)
            layers += [convolution, nn.ELU()]
        self.encoder = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            feature_dim = self.encoder(torch.zeros(1, frames, *size)).shape[-1]
        self.inverse_model = _two_layers(2 * feature_dim, num_actions)
        self.forward_model = _two_layers(feature_dim + num_actions, feature_dim)

    def features(self, stacks: Tensor) -> Tensor:
        """Stacks, uint8 ``[N, H, W, K]``, to features, ``[N, D]``."""
        if tuple(stacks.shape[1:]) != self.stack_shape:
            rule = f"stacks must be [N, {', '.join(map(str, self.stack_shape))}]"
            given = f"channels={self.channels!r}, got {list(stacks.shape)}"
            raise ValueError(f"{rule} with {given}.")
        planes = channels_last(stacks, self.channels).permute(0, 3, 1, 2)
        features: Tensor = self.encoder(planes.float() / 255)
        return features

    def forward(
        self, before: Tensor, action: Tensor, after: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The inverse model's logits and the forward model's error of decisions.

        Args:
            before: stacks before each decision, ``[*B, H, W, K]``.
            action: its number, ``[*B]``, or one-hot, ``[*B, A]``.
            after: stacks after it.

        Returns:
            Logits, ``[*B, A]``, and half the squared distance between the later
            features and their prediction, ``[*B]``.
        """
        shape = before.shape[:-3]
        action = as_numbers(action, shape, self.num_actions)
        stacks = torch.stack([before, after]).flatten(0, -4)
        earlier, later = self.features(stacks).chunk(2)
        logits: Tensor = self.inverse_model(torch.cat([earlier, later], -1))
        if not self.forward_trains_features:
            earlier, later = earlier.detach(), later.detach()
        one_hot = F.one_hot(action.reshape(-1), self.num_actions)
        predicted = self.forward_model(torch.cat([earlier, one_hot], -1))
        error = 0.5 * (predicted - later).square().sum(-1)
        return logits.reshape(*shape, -1), error.reshape(shape)


def _two_layers(inputs: int, outputs: int) -> nn.Sequential:
    """Two linear layers with weights of norm 0.01 for each unit."""
    layers = nn.Linear(inputs, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, outputs)
    for layer in layers[::2]:
        weight = F.normalize(torch.randn_like(layer.weight), dim=-1)
        layer.weight.data.copy_(0.01 * weight)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class CuriosityReward(BonusReward):
    """Pays ``eta`` times the forward model's error of each decision.

    Put it after a `GreyStack`.

    Args:
        icm: the networks.
        eta: scale of the reward.
    """

    def __init__(self, icm: IntrinsicCuriosity, eta: float) -> None:
        super().__init__(in_keys=[FRAME_STACK, ACTION], out_keys=[INTRINSIC_REWARD])
        require_callables(icm=icm)
        self.icm = icm
        self.eta = eta

    @torch.no_grad()
    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        before, action = (read_entry(tensordict, key) for key in self.in_keys)
        _, error = self.icm(before, action, read_entry(next_tensordict, FRAME_STACK))
        return next_tensordict.set(INTRINSIC_REWARD, self.eta * error.unsqueeze(-1))


@dataclass
class ICMConfig(RewardConfig):
    """Settings of ``reward=icm``."""

    eta: float = above(0)
    beta: float = between(0, 1)
    lr: float = above(0)
    max_grad_norm: float = above(0)
    view_size: int = at_least(1)
    frames: int = at_least(1)
    forward_trains_features: bool = MISSING
    update_fraction: float = between(0.001, 1)
    minibatches: int = at_least(1)


class ICMMethod(RewardMethod):
    """The error with which a model predicts the features of the next view.

    The collecting processes compute it, by the newest networks that were there before
    their rollout; the networks are trained here, on each batch.
    """

    schema = ICMConfig
    config: ICMConfig
    # The error of any view falls while the forward model learns.
    selection_metric = None
    reward_key = INTRINSIC_REWARD
    in_keys = (FRAME_STACK, ACTION, _NEXT_STACK)
    saved = ("icm", "optimizer")

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        config = self.config
        self.size = (config.view_size, config.view_size)
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.icm = IntrinsicCuriosity(
                world.spec.num_actions,
                size=self.size,
                frames=config.frames,
                forward_trains_features=config.forward_trains_features,
            )
        self.optimizer = torch.optim.Adam(self.icm.parameters(), lr=config.lr)

    def modules(self) -> dict[str, nn.Module]:
        return {_ICM: self.icm}

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        stack = GreyStack(self.size, self.config.frames)
        return [stack, CuriosityReward(self.icm, self.config.eta)]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Train both models on a part of a batch's decisions.

        Returns:
            Means of both losses, and the share of actions that the inverse model names.
        """
        config = self.config
        before, action, after = (read_entry(batch, key) for key in self.in_keys)
        action = as_numbers(action, batch.batch_size, self.icm.num_actions)
        entries = [one.flatten(0, 1) for one in (before, action, after)]
        num_trained = max(round(config.update_fraction * batch.numel()), 1)
        rows = torch.randperm(batch.numel())[:num_trained]
        measured = [
            self._step(*(entry[piece] for entry in entries))
            for piece in rows.chunk(config.minibatches)
        ]
        names = ("loss_inverse", "loss_forward", "inverse_accuracy")
        means = torch.tensor(measured).mean(0).tolist()
        return dict(zip(names, means, strict=True))

    def _step(
        self, before: Tensor, action: Tensor, after: Tensor
    ) -> tuple[float, float, float]:
        logits, error = self.icm(before, action, after)
        inverse, forward = F.cross_entropy(logits, action), error.mean()
        beta = self.config.beta
        self.optimizer.zero_grad()
        ((1 - beta) * inverse + beta * forward).backward()
        clip_grad_norm_(self.icm.parameters(), self.config.max_grad_norm)
        self.optimizer.step()
        accuracy = (logits.argmax(-1) == action).float().mean()
        return float(inverse.detach()), float(forward.detach()), float(accuracy)
