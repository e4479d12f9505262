"""Scripted policies: random walks and experts."""

from toponav.policies.scripted import (
    FrontierExpert as FrontierExpert,
    PathFollower as PathFollower,
    RandomPolicy as RandomPolicy,
    StickyPolicy as StickyPolicy,
    forward_weights as forward_weights,
)
