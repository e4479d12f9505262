"""Losses, and the optimiser and reward scaling that go with them."""

from toponav.objectives.a3c_loss import A3CLoss as A3CLoss
from toponav.objectives.pair_losses import LLoss as LLoss, TCLoss as TCLoss
from toponav.objectives.recurrent_ppo_loss import (
    RecurrentPPOLoss as RecurrentPPOLoss,
    SequenceMinibatches as SequenceMinibatches,
)
from toponav.objectives.return_scale import ReturnScale as ReturnScale
from toponav.objectives.shared_rmsprop import SharedRMSProp as SharedRMSProp
from toponav.objectives.trpo_loss import TRPOLoss as TRPOLoss
from toponav.objectives.trust_region import (
    TrustRegion as TrustRegion,
    conjugate_gradient as conjugate_gradient,
)
