"""Losses, one LossModule a file, and what their training loops need beside them."""

from toponav.objectives.a3c_loss import A3CLoss
from toponav.objectives.bootstrapped_gae import RecurrentActorCritic, bootstrapped_gae
from toponav.objectives.l_loss import LLoss
from toponav.objectives.recurrent_ppo_loss import RecurrentPPOLoss
from toponav.objectives.return_scale import ReturnScale
from toponav.objectives.sequence_minibatches import SequenceMinibatches
from toponav.objectives.shared_rmsprop import SharedRMSProp
from toponav.objectives.tc_loss import TCLoss

__all__ = [
    "A3CLoss",
    "LLoss",
    "RecurrentActorCritic",
    "RecurrentPPOLoss",
    "ReturnScale",
    "SequenceMinibatches",
    "SharedRMSProp",
    "TCLoss",
    "bootstrapped_gae",
]
