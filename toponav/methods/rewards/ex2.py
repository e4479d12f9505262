"""EX2: pays for views that are easily told from those that were seen before."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage
from torchrl.envs.transforms import Transform

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig, RewardConfig, above, at_least, between
from toponav.data import CompactReplay
from toponav.keys import INTRINSIC_REWARD, SMALL_PIXELS, read_entry
from toponav.methods.rewards.bonus_reward import BonusReward
from toponav.methods.rewards.exemplars import AmortisedExemplars
from toponav.parts import require_callables
from toponav.transforms import PolicyPixels

#: Where the networks are published.
_EX2 = "ex2"
_NEXT_VIEWS: NestedKey = ("next", SMALL_PIXELS)
#: Observations whose median centres the bonus.
_JUDGED = 2048


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
        self.kept = CompactReplay(storage=LazyTensorStorage(capacity))

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
        require_callables(exemplars=exemplars)
        self.exemplars = exemplars
        self.eta = eta

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        bonus = self.exemplars(read_entry(next_tensordict, self.in_keys[0]))
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

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        views = PolicyPixels(self.size, out_keys=[SMALL_PIXELS])
        return [views, ExemplarReward(self.exemplars, self.config.eta)]

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Fit the networks to the views of this batch, against those before."""
        return self.trainer.extend(read_entry(batch, _NEXT_VIEWS).flatten(0, 1))
