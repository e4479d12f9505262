"""EX2: pays for views that are easily told from those that were seen before."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.transforms import Transform
from torchrl.modules import MLP

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, RewardConfig, above, at_least, between
from toponav.keys import INTRINSIC_REWARD, SMALL_PIXELS
from toponav.methods.rewards.bonus_reward import BonusReward
from toponav.transforms import PolicyPixels

#: Where the networks are published.
_EX2 = "ex2"
_NEXT_VIEWS: NestedKey = ("next", SMALL_PIXELS)
#: Bound on a logit: the authors' code keeps probabilities above 0.00001.
_MOST_LOGIT = 11.5
#: Channels, kernel and stride of both convolutions.
_WIDTH, _KERNEL, _STRIDE = 16, 4, 2
#: Observations whose median centres the bonus, and how many are judged at once.
_JUDGED, _CHUNK = 2048, 512


class CodeNetwork(nn.Module):
    """A Gaussian code of an observation: its mean and the logarithm of its variance."""

    def __init__(self, shape: tuple[int, ...], code_dim: int, hidden: int) -> None:
        super().__init__()
        self.is_view = len(shape) == 3
        sizes = {"num_cells": [hidden], "activation_class": nn.Tanh}
        layers: list[nn.Module] = [MLP(shape[0], hidden, **sizes), nn.Tanh()]
        if self.is_view:
            layers = []
            for channels in (shape[-1], _WIDTH):
                # Padded so that every pixel is seen as often.
                layer = nn.Conv2d(channels, _WIDTH, _KERNEL, _STRIDE, _KERNEL - 1)
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
            observation = observation.permute(0, 3, 1, 2)
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

    Examples:
        >>> exemplars = AmortisedExemplars((32, 32, 3))
        >>> exemplars(torch.zeros(2, 5, 32, 32, 3, dtype=torch.uint8)).shape
        torch.Size([2, 5])
    """

    median: Tensor
    fitted: Tensor

    def __init__(
        self, shape: tuple[int, ...], code_dim: int = 16, hidden: int = 32
    ) -> None:
        super().__init__()
        self.shape = tuple(shape)
        self.of_exemplar = CodeNetwork(self.shape, code_dim, hidden)
        self.of_other = CodeNetwork(self.shape, code_dim, hidden)
        self.classifier = MLP(2 * code_dim, 1, num_cells=[hidden])
        self.register_buffer("median", torch.zeros(()))
        self.register_buffer("fitted", torch.zeros((), dtype=torch.bool))

    @torch.no_grad()
    def forward(self, observation: Tensor) -> Tensor:
        """Bonuses, ``[*B, *shape]`` to ``[*B]``; 0 until the first fit."""
        batch = observation.shape[: -len(self.shape)]
        if not self.fitted:
            return torch.zeros(batch, device=observation.device)
        flat = observation.reshape(-1, *self.shape)
        logits = torch.cat([self.logit(piece) for piece in flat.split(_CHUNK)])
        return (logits - self.median).reshape(batch)

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


class ExemplarTrainer:
    """Fits `AmortisedExemplars` to tell the newest observations from those before.

    Args:
        exemplars: the networks.
        lr: learning rate of Adam.
        update_rate: updates for each observation of a batch.
        pairs: true and false pairs of an update.
        kl_weight: weight of the codes' KL.
        keep_fraction: share of each batch that is kept as earlier observations.
        capacity: number of those that are kept, the newest ones.
    """

    def __init__(
        self,
        exemplars: AmortisedExemplars,
        *,
        lr: float = 1e-4,
        update_rate: float = 0.25,
        pairs: int = 128,
        kl_weight: float = 0.001,
        keep_fraction: float = 1.0,
        capacity: int = 250_000,
    ) -> None:
        self.exemplars = exemplars
        self.update_rate, self.pairs, self.kl_weight = update_rate, pairs, kl_weight
        self.keep_fraction = keep_fraction
        self.optimizer = torch.optim.Adam(exemplars.parameters(), lr=lr)
        self.kept = TensorDictReplayBuffer(storage=LazyTensorStorage(capacity))

    def extend(self, observation: Tensor) -> dict[str, float]:
        """Fit the networks to observations, ``[N, *shape]``, then keep a part of them.

        The first batch is only kept; the second has twice as many updates. Returns
        means over the last tenth of them: loss and probability of true pairs.
        """
        measured = {}
        if len(self.kept):
            measured = self._fit(observation)
        size = max(round(self.keep_fraction * len(observation)), 1)
        rows = torch.randperm(len(observation))[:size]
        self.kept.extend(TensorDict({"observation": observation[rows]}, [size]))
        return measured

    def _fit(self, observation: Tensor) -> dict[str, float]:
        updates = max(round(self.update_rate * len(observation)), 1)
        if not self.exemplars.fitted:
            updates *= 2
        found = [self._update(observation) for _ in range(updates)]
        rows = torch.randperm(len(observation))[:_JUDGED]
        self.exemplars.fitted.fill_(True)
        # What was subtracted from bonuses so far comes to it.
        self.exemplars.median += self.exemplars(observation[rows]).median()
        last = torch.tensor(found[-max(updates // 10, 1) :]).mean(0).tolist()
        return {"loss_exemplars": last[0], "true_probability": last[1]}

    def _update(self, observation: Tensor) -> tuple[float, float]:
        rows = torch.randint(len(observation), (self.pairs,))
        earlier = self.kept.sample(self.pairs)["observation"]
        loss, probability = self.exemplars.loss(
            observation[rows], earlier, self.kl_weight
        )
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return float(loss.detach()), float(probability)


class ExemplarReward(BonusReward):
    """Pays ``eta`` times the bonus of the observation that each decision leads to.

    ``key`` is that of the observation.
    """

    def __init__(
        self,
        exemplars: AmortisedExemplars,
        eta: float,
        *,
        key: NestedKey = SMALL_PIXELS,
    ) -> None:
        super().__init__(in_keys=[key], out_keys=[INTRINSIC_REWARD])
        self.exemplars = exemplars
        self.eta = eta

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        bonus = self.exemplars(next_tensordict.get(self.in_keys[0]))
        return next_tensordict.set(INTRINSIC_REWARD, self.eta * bonus.unsqueeze(-1))


@dataclass
class EX2Config(RewardConfig):
    """Settings of ``reward=ex2``."""

    eta: float = above(0)
    view_size: int = at_least(1)
    kl_weight: float = at_least(0)
    lr: float = above(0)
    update_rate: float = above(0)
    pairs: int = at_least(1)
    keep_fraction: float = between(0.001, 1)
    capacity: int = at_least(1)


class EX2Method(RewardMethod):
    """How easily a network tells a view from those of earlier batches.

    Collecting processes compute it; the networks are fitted here, to each batch.
    """

    schema = EX2Config
    config: EX2Config
    # Every batch has a centre of its own.
    selection_metric = None
    reward_key = INTRINSIC_REWARD
    in_keys = (_NEXT_VIEWS,)
    saved = ("exemplars", "optimizer", "kept")

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        config = self.config
        self.size = (config.view_size, config.view_size)
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.exemplars = AmortisedExemplars((*self.size, 3))
        self.trainer = ExemplarTrainer(
            self.exemplars,
            lr=config.lr,
            update_rate=config.update_rate,
            pairs=config.pairs,
            kl_weight=config.kl_weight,
            keep_fraction=config.keep_fraction,
            capacity=config.capacity,
        )
        self.optimizer, self.kept = self.trainer.optimizer, self.trainer.kept

    def modules(self) -> dict[str, nn.Module]:
        return {_EX2: self.exemplars}

    def updated(self) -> Collection[str]:
        return (_EX2,)

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        views = PolicyPixels(self.size, out_keys=[SMALL_PIXELS])
        return [views, ExemplarReward(self.exemplars, self.config.eta)]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Fit the networks to the views of this batch, against those before."""
        return self.trainer.extend(batch.get(_NEXT_VIEWS).flatten(0, 1))
