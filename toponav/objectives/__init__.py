"""Losses: one LossModule a file."""

from toponav.objectives.l_loss import LLoss
from toponav.objectives.tc_loss import TCLoss

__all__ = ["LLoss", "TCLoss"]
