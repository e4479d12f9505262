"""Reward methods. A new one is a file here and a line in `REWARDS`."""

from toponav.builders import Networks, RewardMethod, World
from toponav.config import ExploreConfig
from toponav.methods.rewards.coverage import CoverageMethod
from toponav.methods.rewards.ex2 import (
    EX2Method,
    ExemplarReward as ExemplarReward,
    ExemplarTrainer as ExemplarTrainer,
)
from toponav.methods.rewards.exemplars import AmortisedExemplars as AmortisedExemplars
from toponav.methods.rewards.extrinsic import ExtrinsicMethod
from toponav.methods.rewards.grey_stack import GreyStack as GreyStack
from toponav.methods.rewards.icm import (
    ICMMethod,
    IntrinsicCuriosity as IntrinsicCuriosity,
)
from toponav.methods.rewards.novelty import NoveltyMethod
from toponav.methods.rewards.random import RandomMethod
from toponav.methods.rewards.rnd import (
    RandomNetworkDistillation as RandomNetworkDistillation,
    RNDMethod,
)
from toponav.methods.rewards.vime import (
    BayesianDynamics as BayesianDynamics,
    DynamicsTrainer as DynamicsTrainer,
    InformationGainReward as InformationGainReward,
    VIMEMethod,
)

#: By the name of their settings, ``conf/reward/<name>.yaml``.
REWARDS = {
    "novelty": NoveltyMethod,
    "coverage": CoverageMethod,
    "random": RandomMethod,
    "rnd": RNDMethod,
    "icm": ICMMethod,
    "vime": VIMEMethod,
    "ex2": EX2Method,
    "extrinsic": ExtrinsicMethod,
}


def make_reward(
    settings: ExploreConfig, world: World, networks: Networks | None
) -> RewardMethod:
    """The reward method that the settings name; its arguments are `RewardMethod`'s.

    Raises `SettingsError` if it does not fit the world or the networks.
    """
    return REWARDS[settings.reward.name](settings, world, networks)
