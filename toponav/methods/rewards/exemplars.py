"""`AmortisedExemplars`: how easily an observation is told from earlier ones."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.modules import MLP

from toponav.methods.rewards.bonus_reward import batch_of
from toponav.views import ChannelOrder, channels_last, check_order, check_views

#: Bound on a logit: the authors' code keeps probabilities above 0.00001.
_MOST_LOGIT = 11.5
#: Channels, kernel and stride of both convolutions.
_WIDTH, _KERNEL, _STRIDE = 16, 4, 2
#: Observations that are judged at once.
_CHUNK = 512


class CodeNetwork(nn.Module):
    """A Gaussian code of an observation: its mean and the logarithm of its variance."""

    def __init__(
        self,
        shape: tuple[int, ...],
        code_dim: int,
        hidden: int,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        self.is_view, self.channels = len(shape) == 3, check_order(channels)
        sizes = {"num_cells": [hidden], "activation_class": nn.Tanh}
        layers: list[nn.Module] = [MLP(shape[0], hidden, **sizes), nn.Tanh()]
        if self.is_view:
            layers = []
            for planes in (shape[-1 if channels == "HWC" else 0], _WIDTH):
                # Padded so that every pixel is seen as often.
                layer = nn.Conv2d(planes, _WIDTH, _KERNEL, _STRIDE, _KERNEL - 1)
                layers += [layer, nn.Tanh()]
            layers.append(nn.Flatten())
        self.encoder = nn.Sequential(*layers)
        size = self.encode(torch.zeros(1, *shape)).shape[-1]
        self.mean = MLP(size, code_dim, **sizes)
        self.log_variance = MLP(size, code_dim, **sizes)

    def encode(self, observation: Tensor) -> Tensor:
        """``[N, *shape]`` to ``[N, F]``; uint8 ones are divided by 255."""
        if observation.dtype == torch.uint8:
            observation = observation.float() / 255
        if self.is_view:
            seen = channels_last(observation, self.channels)
            observation = seen.permute(0, 3, 1, 2)
        features: Tensor = self.encoder(observation)
        return features

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        code = self.encode(observation)
        return self.mean(code), self.log_variance(code)


class AmortisedExemplars(nn.Module):
    """Tells whether an observation is a given one, the exemplar, or an earlier one.

    One network serves all exemplars: it reads codes of the exemplar and of the
    observation, from two networks of the same shape. Where the best one says that an
    exemplar is itself with probability D, the density of earlier observations there is
    ``(1 - D) / D``. Its output is ``-log`` of that, the logit of D, less the median of
    the last batch.

    Reference:
        Fu et al., "EX2: Exploration with Exemplar Models for Deep Reinforcement
        Learning" (2017), sections 4.1 and 5.1, and their code.

    Args:
        shape: of an observation, ``(D,)``, or of a view, ``(H, W, C)``.
        code_dim: length of a code.
        hidden: width of the hidden layers.
        channels: ``"HWC"``, or ``"CHW"`` for views ``(C, H, W)``.

    Examples:
        >>> exemplars = AmortisedExemplars((32, 32, 3))
        >>> exemplars(torch.zeros(2, 5, 32, 32, 3, dtype=torch.uint8)).shape
        torch.Size([2, 5])
    """

    median: Tensor
    fitted: Tensor

    def __init__(
        self,
        shape: tuple[int, ...],
        code_dim: int = 16,
        hidden: int = 32,
        *,
        channels: ChannelOrder = "HWC",
    ) -> None:
        super().__init__()
        self.shape = tuple(shape)
        if len(shape) == 3:
            check_views("shape", self.shape, channels)
        self.of_exemplar = CodeNetwork(self.shape, code_dim, hidden, channels)
        self.of_other = CodeNetwork(self.shape, code_dim, hidden, channels)
        self.classifier = MLP(2 * code_dim, 1, num_cells=[hidden])
        self.register_buffer("median", torch.zeros(()))
        self.register_buffer("fitted", torch.zeros((), dtype=torch.bool))

    @torch.no_grad()
    def forward(self, observation: Tensor) -> Tensor:
        """Bonuses, ``[*B, *shape]`` to ``[*B]``; 0 until the first fit."""
        batch = batch_of(observation, self.shape)
        flat = observation.reshape(-1, *self.shape)
        logits = torch.cat([self.logit(piece) for piece in flat.split(_CHUNK)])
        # Not asked whether it is fitted: that would wait for a GPU.
        return ((logits - self.median) * self.fitted).reshape(batch)

    def logit(self, observation: Tensor) -> Tensor:
        """Of the probability that an observation is itself, ``[N]``, by mean codes."""
        codes = self.of_exemplar(observation)[0], self.of_other(observation)[0]
        logit: Tensor = self.classifier(torch.cat(codes, -1)).squeeze(-1)
        return logit.clamp(-_MOST_LOGIT, _MOST_LOGIT)

    def loss(
        self, exemplar: Tensor, earlier: Tensor, kl_weight: float
    ) -> tuple[Tensor, Tensor]:
        """Loss of pairs ``[N, *shape]``, and the mean probability of true ones.

        Each exemplar is paired with itself (true) and with an earlier observation. To
        the cross-entropy comes the weighed KL of the codes from N(0, 1), in nats.
        """
        count = len(exemplar)
        first, first_kl = _draw(*self.of_exemplar(exemplar))
        second, second_kl = _draw(*self.of_other(torch.cat([exemplar, earlier])))
        codes = torch.cat([first.repeat(2, 1), second], -1)
        logits = self.classifier(codes).squeeze(-1)
        label = (torch.arange(2 * count, device=logits.device) < count).float()
        entropy = F.binary_cross_entropy_with_logits(logits, label)
        loss = entropy + kl_weight * (first_kl + second_kl)
        return loss, logits[:count].detach().sigmoid().mean()


def _draw(mean: Tensor, log_variance: Tensor) -> tuple[Tensor, Tensor]:
    """Codes, ``[N, C]``, and the mean KL of their Gaussians from N(0, 1)."""
    code = mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
    kl = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)
    return code, kl.sum(-1).mean()
