"""What is chosen by name, one file a method: rewards, learners, worlds, navigators."""

from toponav.methods.learners import (
    LEARNERS as LEARNERS,
    ActorCriticLearner as ActorCriticLearner,
)
from toponav.methods.registry import METHODS as METHODS, register as register
from toponav.methods.rewards import REWARDS as REWARDS, make_reward as make_reward
from toponav.methods.worlds import (
    WORLDS as WORLDS,
    make_world as make_world,
    make_worlds as make_worlds,
)
