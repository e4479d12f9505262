"""Networks: encoders, the TC-network, the L-network, the explorer's actor-critic."""

from toponav.modules.actor_critic import ActorCritic as ActorCritic
from toponav.modules.comparators import (
    Comparator as Comparator,
    ConcatComparator as ConcatComparator,
    DifferenceComparator as DifferenceComparator,
)
from toponav.modules.episodic_lstm import EpisodicLSTM as EpisodicLSTM
from toponav.modules.l_network import (
    LNetwork as LNetwork,
    LocomotionHead as LocomotionHead,
)
from toponav.modules.policy_trunks import (
    EmbeddingTrunk as EmbeddingTrunk,
    PixelTrunk as PixelTrunk,
)
from toponav.modules.resnet import ResNet18 as ResNet18
from toponav.modules.rnd import RandomNetworkDistillation as RandomNetworkDistillation
from toponav.modules.small_encoder import SmallEncoder as SmallEncoder
from toponav.modules.tc_network import TCNetwork as TCNetwork
