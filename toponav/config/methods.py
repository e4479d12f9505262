"""What every reward method, learner and world has in its settings.

The settings of one method alone are beside the method, in ``toponav/methods``.
"""

from dataclasses import dataclass

from omegaconf import MISSING

from toponav.config.checks import require_above_zero, require_at_least, require_between


@dataclass
class RewardConfig:
    """A reward method (``conf/reward``)."""

    name: str = MISSING


@dataclass
class LearnerConfig:
    """A learner (``conf/loss``)."""

    name: str = MISSING
    lr: float = MISSING
    final_lr: float = MISSING
    rollout: int = MISSING
    max_grad_norm: float = MISSING

    def __post_init__(self) -> None:
        for name in ("lr", "max_grad_norm"):
            require_above_zero(f"loss.{name}", getattr(self, name))
        require_between("loss.final_lr", self.final_lr, 0, 1)
        require_at_least("loss.rollout", self.rollout, 1)

    def check(self, num_envs: int) -> None:
        """Refuse settings that do not fit the number of environments."""


@dataclass
class WorldConfig:
    """A world (``conf/world``)."""

    name: str = MISSING
    label: str = MISSING
    episode_length: int = MISSING

    def __post_init__(self) -> None:
        require_at_least(self.length_setting, self.episode_length, 1)

    @property
    def length_setting(self) -> str:
        """The setting that says how long an episode is: mazes have their own."""
        return f"{'maze' if self.name == 'maze' else 'world'}.episode_length"
