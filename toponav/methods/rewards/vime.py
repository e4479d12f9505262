"""VIME: pays for decisions whose outcome teaches a model of the world something."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.data import LazyTensorStorage
from torchrl.envs.transforms import Transform

from toponav.actions import as_numbers
from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, RewardConfig, above, at_least
from toponav.data import CompactReplay
from toponav.keys import ACTION, FRAME_STACK, INTRINSIC_REWARD, read_entry
from toponav.methods.rewards.bonus_reward import BonusReward, batch_of
from toponav.methods.rewards.grey_stack import GreyStack
from toponav.modules import BayesianNetwork
from toponav.parts import require_callables

#: The name under which the model is published.
_VIME = "vime"
_NEXT_STACK: NestedKey = ("next", FRAME_STACK)
#: Bound on an information gain in nats, as in the authors' code.
_MOST_GAIN = 1000.0
#: Batches whose medians scale the reward.
_MEDIANS = 10
#: Decisions that observations are standardised by, that a median is taken of, and that
#: are judged at once, since each needs room for all weights.
_COUNTED, _JUDGED, _CHUNK = 4096, 1024, 256


class BayesianDynamics(nn.Module):
    """Predicts the next observation from this one and an action by a Bayesian network.

    Its output is how much an outcome would teach it, over the mean of the medians of
    the last batches. Observations are standardised by what `DynamicsTrainer` has kept.

    Reference:
        Houthooft et al., "VIME: Variational Information Maximizing Exploration" (2016),
        sections 2.3 to 2.5, and their code.

    Args:
        shape: of an observation; uint8 ones are divided by 255.
        num_actions: number A of actions.
        hidden: width of the hidden layer.
        step_size: length of the imagined step of the weights.
        noise_deviation: of an outcome around its prediction; 1 is an observation's own.
        least_deviation: of an element of the observation, so that one that hardly ever
            changes is not blown up.

    Examples:
        >>> dynamics = BayesianDynamics((2,), num_actions=3)
        >>> before, after = torch.randn(2, 4, 2)
        >>> dynamics(before, torch.zeros(4, dtype=torch.int64), after)
        tensor([0., 0., 0., 0.])
        >>> dynamics.count_median(torch.tensor([1.0, 2.0, 9.0]))
        >>> dynamics.scale
        tensor(2.)
    """

    mean: Tensor
    deviation: Tensor
    medians: Tensor

    def __init__(
        self,
        shape: tuple[int, ...],
        num_actions: int,
        *,
        hidden: int = 32,
        step_size: float = 0.01,
        noise_deviation: float = 5.0,
        least_deviation: float = 1e-6,
    ) -> None:
        super().__init__()
        self.shape = tuple(shape)
        self.num_actions = num_actions
        self.step_size = step_size
        self.least_deviation = least_deviation
        size = torch.Size(shape).numel()
        self.network = BayesianNetwork(
            size + num_actions, size, hidden=hidden, noise_deviation=noise_deviation
        )
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("deviation", torch.ones(size))
        # The newest is last; -1 where there was no batch yet, which a checkpoint may
        # hold and NaN may not.
        self.register_buffer("medians", torch.full((_MEDIANS,), -1.0))

    def forward(self, before: Tensor, action: Tensor, after: Tensor) -> Tensor:
        """Relative information gain of decisions, ``[*B]``; 0 before the first batch.

        Observations are ``[*B, *shape]``, actions numbers ``[*B]`` or one-hot ``[*B,
        A]``.
        """
        # Not asked whether there was a batch, but divided by infinity before the first
        # one: to ask would wait for a GPU.
        scale = self.scale.nan_to_num(torch.inf)
        return self.gain(before, action, after) / scale

    @property
    def scale(self) -> Tensor:
        """Mean of the medians of the last batches in nats, at least 1e-8."""
        known = self.medians.masked_fill(self.medians < 0, torch.nan)
        return known.nanmean().clamp_min(1e-8)

    def gain(self, before: Tensor, action: Tensor, after: Tensor) -> Tensor:
        """Information gain of decisions in nats, ``[*B]``."""
        inputs, outcomes = self.standardise(before, action, after)
        gains = [
            self.network.information_gain(*piece, self.step_size)
            for piece in zip(inputs.split(_CHUNK), outcomes.split(_CHUNK), strict=True)
        ]
        gain = torch.cat(gains).clamp(0, _MOST_GAIN)
        return gain.reshape(batch_of(before, self.shape))

    def standardise(
        self, before: Tensor, action: Tensor, after: Tensor
    ) -> tuple[Tensor, Tensor]:
        """What the network reads and what it is to predict of decisions, flat."""
        now, later = (
            (self.flat(one) - self.mean) / self.deviation for one in (before, after)
        )
        numbers = as_numbers(action, batch_of(before, self.shape), self.num_actions)
        taken = F.one_hot(numbers.reshape(-1), self.num_actions)
        return torch.cat([now, taken.to(now)], -1), later

    def flat(self, observation: Tensor) -> Tensor:
        """Observations as numbers, ``[*B, *shape]`` to ``[N, D]``."""
        flat = observation.reshape(-1, len(self.mean)).float()
        return flat / 255 if observation.dtype == torch.uint8 else flat

    @torch.no_grad()
    def count(self, observation: Tensor) -> None:
        """Standardise by these observations from now on."""
        flat = self.flat(observation)
        self.mean.copy_(flat.mean(0))
        self.deviation.copy_(flat.std(0, correction=0).clamp_min(self.least_deviation))

    def count_median(self, gain: Tensor) -> None:
        """Scale by the median of these gains, too."""
        median = gain.median().clamp_min(0).reshape(1)
        self.medians.copy_(torch.cat([self.medians[1:], median]))


class DynamicsTrainer:
    """Fits a `BayesianDynamics` to decisions that it keeps.

    Args:
        dynamics: the model.
        lr: learning rate of Adam.
        update_rate: updates of the model for each decision of a batch.
        minibatch: decisions of an update.
        capacity: number of decisions that are kept, the newest ones.
        prior_weight: weight of the KL from the prior in an update's loss.
    """

    def __init__(
        self,
        dynamics: BayesianDynamics,
        *,
        lr: float = 1e-3,
        update_rate: float = 0.1,
        minibatch: int = 10,
        capacity: int = 100_000,
        prior_weight: float = 0.2,
    ) -> None:
        self.dynamics = dynamics
        self.update_rate, self.minibatch = update_rate, minibatch
        self.prior_weight = prior_weight
        self.optimizer = torch.optim.Adam(dynamics.parameters(), lr=lr)
        self.kept = CompactReplay(storage=LazyTensorStorage(capacity))

    def extend(self, before: Tensor, action: Tensor, after: Tensor) -> dict[str, float]:
        """Keep N decisions, fit the model, and count the median of their gains.

        Returns:
            Mean squared error of the standardised predictions in the last tenth of the
            updates, the divergence of the weights from their prior, and the median of
            the information gains of these decisions in nats.
        """
        entries = {"before": before, "action": action, "after": after}
        self.kept.extend(TensorDict(entries, [len(action)]))
        dynamics = self.dynamics
        dynamics.count(self.kept.sample(min(_COUNTED, len(self.kept)))["before"])
        size = self.minibatch
        drawn = self.kept.sample(size * max(round(self.update_rate * len(action)), 1))
        inputs, outcomes = dynamics.standardise(*(drawn[key] for key in entries))
        pieces = zip(inputs.split(size), outcomes.split(size), strict=True)
        errors = [self._update(seen, outcome) for seen, outcome in pieces]
        rows = torch.randperm(len(action))[:_JUDGED]
        gain = dynamics.gain(before[rows], action[rows], after[rows])
        dynamics.count_median(gain)
        last = errors[-max(len(errors) // 10, 1) :]
        return {
            "prediction_error": sum(last) / len(last),
            "weights_divergence": float(dynamics.network.divergence().detach()),
            "median_gain": float(gain.median()),
        }

    def _update(self, inputs: Tensor, outcomes: Tensor) -> float:
        network = self.dynamics.network
        predictions = network(inputs)
        loss = network.loss(predictions, outcomes, self.prior_weight)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return float((predictions.detach().mean(0) - outcomes).square().mean())


class InformationGainReward(BonusReward):
    """Pays ``eta`` times the relative information gain of each decision.

    ``key`` is that of the observation.
    """

    def __init__(
        self, dynamics: BayesianDynamics, eta: float, *, key: NestedKey = FRAME_STACK
    ) -> None:
        super().__init__(in_keys=[key, ACTION], out_keys=[INTRINSIC_REWARD])
        require_callables(dynamics=dynamics)
        self.dynamics = dynamics
        self.eta = eta

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        observation, action = (read_entry(tensordict, key) for key in self.in_keys)
        following = read_entry(next_tensordict, self.in_keys[0])
        gain = self.dynamics(observation, action, following)
        return next_tensordict.set(INTRINSIC_REWARD, self.eta * gain.unsqueeze(-1))


@dataclass
class VIMEConfig(RewardConfig):
    """Settings of ``reward=vime``."""

    eta: float = above(0)
    view_size: int = at_least(1)
    hidden: int = at_least(1)
    noise_deviation: float = above(0)
    prior_weight: float = at_least(0)
    step_size: float = above(0)
    lr: float = above(0)
    update_rate: float = above(0)
    minibatch: int = at_least(1)
    capacity: int = at_least(1)


class VIMEMethod(RewardMethod):
    """What the outcome of a decision teaches a Bayesian model of small grey views.

    The collecting processes compute it, by the newest model that was there before
    their rollout; the model is fitted here, after each batch.
    """

    schema = VIMEConfig
    config: VIMEConfig
    # The gain of any decision falls while the model learns.
    selection_metric = None
    reward_key = INTRINSIC_REWARD
    in_keys = (FRAME_STACK, ACTION, _NEXT_STACK)
    saved = ("dynamics", "optimizer", "kept")

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        super().__init__(settings, world, networks)
        config = self.config
        self.size = (config.view_size, config.view_size)
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.dynamics = BayesianDynamics(
                (*self.size, 1),
                world.spec.num_actions,
                hidden=config.hidden,
                noise_deviation=config.noise_deviation,
                step_size=config.step_size,
                least_deviation=1 / 255,
            )
        self.trainer = DynamicsTrainer(
            self.dynamics,
            lr=config.lr,
            update_rate=config.update_rate,
            minibatch=config.minibatch,
            capacity=config.capacity,
            prior_weight=config.prior_weight,
        )
        self.optimizer, self.kept = self.trainer.optimizer, self.trainer.kept

    def modules(self) -> dict[str, nn.Module]:
        return {_VIME: self.dynamics}

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        stack = GreyStack(self.size, frames=1)
        return [stack, InformationGainReward(self.dynamics, self.config.eta)]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Fit the model to the decisions of this batch and of those before."""
        entries = [read_entry(batch, key).flatten(0, 1) for key in self.in_keys]
        return self.trainer.extend(*entries)
