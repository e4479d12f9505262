"""Networks: encoders, the TC-network with its comparators, the L-network."""

from toponav.modules.comparators import (
    Comparator,
    ConcatComparator,
    DifferenceComparator,
)
from toponav.modules.l_network import LNetwork, LocomotionHead
from toponav.modules.resnet import ResNet18
from toponav.modules.small_encoder import SmallEncoder
from toponav.modules.tc_network import TCNetwork

__all__ = [
    "Comparator",
    "ConcatComparator",
    "DifferenceComparator",
    "LNetwork",
    "LocomotionHead",
    "ResNet18",
    "SmallEncoder",
    "TCNetwork",
]
