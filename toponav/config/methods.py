"""What every reward method, learner and world has in its settings.

The settings of one method alone are beside the method, in ``toponav/methods``.
"""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import Settings, above, at_least, between


@dataclass
class RewardConfig(Settings):
    """A reward method (``conf/reward``)."""

    group = "reward"
    name: str = MISSING


@dataclass
class LearnerConfig(Settings):
    """A learner (``conf/loss``)."""

    group = "loss"
    name: str = MISSING
    lr: float = above(0)
    final_lr: float = between(0, 1)
    rollout: int = at_least(1)
    max_grad_norm: float = above(0)

    def check(self, num_envs: int) -> None:
        """Refuse settings that do not fit the number of environments."""


@dataclass
class WorldConfig(Settings):
    """A world (``conf/world``)."""

    group = "world"
    name: str = MISSING
    label: str = MISSING
    episode_length: int = at_least(1)
