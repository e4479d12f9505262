"""Nav A3C: A3C with a stacked LSTM that also feels its velocity."""

from dataclasses import dataclass

from toponav.builders import World
from toponav.config import ExploreConfig, at_least, require
from toponav.methods.learners.a3c import A3CConfig, A3CLearner
from toponav.modules import NavActorCritic


@dataclass
class NavA3CConfig(A3CConfig):
    """Settings of ``loss=nav_a3c``."""

    first_hidden: int = at_least(1)


class NavA3CLearner(A3CLearner):
    """The navigating agent of Mirowski et al., without auxiliary tasks.

    Reference:
        Mirowski et al., "Learning to Navigate in Complex Environments" (2016).
    """

    schema = NavA3CConfig
    senses = ("velocity",)

    @staticmethod
    def make_policy(settings: ExploreConfig, world: World) -> NavActorCritic:
        policy, loss, motion = settings.policy, settings.loss, world.spec.motion
        assert isinstance(loss, NavA3CConfig)
        assert motion is not None, "worlds with a velocity have a motion"
        rule = f"policy.input must be pixels with loss={loss.name}"
        require(policy.input == "pixels", rule, policy.input)
        rule = f"policy.layers must be 1 with loss={loss.name}"
        require(policy.layers == 1, rule, policy.layers)
        return NavActorCritic(
            step=motion.step,
            turn=motion.turn,
            first_dim=loss.first_hidden,
            image_size=(policy.view_size, policy.view_size),
            num_actions=world.spec.num_actions,
            code_dim=policy.hidden,
            hidden_dim=policy.hidden,
        )
