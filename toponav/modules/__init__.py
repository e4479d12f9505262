"""Networks: encoders, the TC-network, the L-network, the explorer's actor-critic."""

from toponav.modules.actor_critic import ActorCritic
from toponav.modules.comparators import (
    Comparator,
    ConcatComparator,
    DifferenceComparator,
)
from toponav.modules.episodic_lstm import EpisodicLSTM
from toponav.modules.l_network import LNetwork, LocomotionHead
from toponav.modules.policy_trunks import EmbeddingTrunk, PixelTrunk
from toponav.modules.resnet import ResNet18
from toponav.modules.small_encoder import SmallEncoder
from toponav.modules.tc_network import TCNetwork

__all__ = [
    "ActorCritic",
    "Comparator",
    "ConcatComparator",
    "DifferenceComparator",
    "EmbeddingTrunk",
    "EpisodicLSTM",
    "LNetwork",
    "LocomotionHead",
    "PixelTrunk",
    "ResNet18",
    "SmallEncoder",
    "TCNetwork",
]
