"""Random network distillation: pays for views that are hard to predict."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import nn
from torchrl.envs.transforms import RNDTransform, Transform
from torchrl.objectives.rnd import RNDLoss

from toponav.builders import Networks, RewardMethod, World
from toponav.config import (
    ExploreConfig,
    RewardConfig,
    above,
    at_least,
    between,
)
from toponav.keys import INTRINSIC_REWARD, POLICY_PIXELS
from toponav.modules import RandomNetworkDistillation
from toponav.transforms import PolicyPixels

#: The name under which the networks are published.
_RND = "rnd"
_NEXT_VIEWS: NestedKey = ("next", POLICY_PIXELS)


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

    Reference:
        Burda et al., "Exploration by Random Network Distillation" (2018).
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

    def updated(self) -> Collection[str]:
        return (_RND,)

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
        views = batch.get(_NEXT_VIEWS).flatten(0, 1)
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
