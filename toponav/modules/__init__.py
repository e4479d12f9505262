"""Networks: encoders, the TC-network, the L-network, the explorer's actor-critic."""

from toponav.modules.actor_critic import (
    NEXT_HIDDEN as NEXT_HIDDEN,
    ActorCritic as ActorCritic,
    EpisodicLSTM as EpisodicLSTM,
    StatePrimer as StatePrimer,
)
from toponav.modules.bayesian_network import BayesianNetwork as BayesianNetwork
from toponav.modules.encoders import (
    ResNet18 as ResNet18,
    SmallEncoder as SmallEncoder,
    check_pixels as check_pixels,
    start_orthogonal as start_orthogonal,
)
from toponav.modules.ground_network import GroundNetwork as GroundNetwork
from toponav.modules.nav_actor_critic import (
    NavActorCritic as NavActorCritic,
    StackedLSTM as StackedLSTM,
)
from toponav.modules.offset_network import OffsetNetwork as OffsetNetwork
from toponav.modules.pair_networks import (
    Comparator as Comparator,
    ConcatComparator as ConcatComparator,
    DifferenceComparator as DifferenceComparator,
    LNetwork as LNetwork,
    LocomotionHead as LocomotionHead,
    TCNetwork as TCNetwork,
)
from toponav.modules.place_network import PlaceNetwork as PlaceNetwork
from toponav.modules.scaled_mlp import ScaledMLP as ScaledMLP
from toponav.modules.steering_network import (
    SteeringNetwork as SteeringNetwork,
    SteeringValue as SteeringValue,
)
