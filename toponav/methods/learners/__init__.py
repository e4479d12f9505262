"""Learners. A new one is a file here and a line in `LEARNERS`."""

from toponav.builders import Learner
from toponav.methods.learners.a3c import A3CLearner
from toponav.methods.learners.actor_critic import (
    ActorCriticLearner as ActorCriticLearner,
)
from toponav.methods.learners.ppo import PPOLearner
from toponav.methods.learners.trpo import TRPOLearner

#: By the name of their settings, ``conf/loss/<name>.yaml``.
LEARNERS: dict[str, type[Learner]] = {
    "ppo": PPOLearner,
    "a3c": A3CLearner,
    "trpo": TRPOLearner,
}
