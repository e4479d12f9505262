"""Learners. A new one is a file here and a line in `LEARNERS`."""

from toponav.builders import Learner
from toponav.methods.learners.a3c import A3CLearner
from toponav.methods.learners.actor_critic import (
    ActorCriticLearner as ActorCriticLearner,
)
from toponav.methods.learners.dqn import DQNLearner
from toponav.methods.learners.drqn import DRQNLearner
from toponav.methods.learners.nav_a3c import NavA3CLearner
from toponav.methods.learners.nav_a3c_d2l import NavA3CD2LLearner
from toponav.methods.learners.ppo import PPOLearner
from toponav.methods.learners.trpo import TRPOLearner

#: By the name of their settings, ``conf/loss/<name>.yaml``.
LEARNERS: dict[str, type[Learner]] = {
    "ppo": PPOLearner,
    "a3c": A3CLearner,
    "trpo": TRPOLearner,
    "dqn": DQNLearner,
    "drqn": DRQNLearner,
    "nav_a3c": NavA3CLearner,
    "nav_a3c_d2l": NavA3CD2LLearner,
}
