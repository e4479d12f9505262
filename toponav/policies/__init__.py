"""Scripted policies: random walks and experts."""

from toponav.policies.experts import (
    FrontierExpert as FrontierExpert,
    PathFollower as PathFollower,
)
from toponav.policies.random_walks import (
    RandomPolicy as RandomPolicy,
    StickyPolicy as StickyPolicy,
    forward_weights as forward_weights,
)
