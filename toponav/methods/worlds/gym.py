"""Any Gymnasium environment with pixels and discrete actions."""

from dataclasses import dataclass

from omegaconf import MISSING
from torchrl.envs import EnvBase

from toponav.builders import World
from toponav.config import ExploreConfig, PretrainConfig, WorldConfig, refusing
from toponav.envs import make_pixel_env


@dataclass
class GymWorldConfig(WorldConfig):
    """Settings of ``world=gym``."""

    id: str = MISSING
    render: bool = MISSING


class GymWorld(World):
    """A Gymnasium environment with pixels and discrete actions; no ground truth."""

    schema = GymWorldConfig

    def __init__(self, settings: ExploreConfig | PretrainConfig) -> None:
        assert isinstance(settings.world, GymWorldConfig)
        self.config = config = settings.world
        self.name = config.label
        self.episode_length = config.episode_length
        self.layout = None
        env = self.make_env(batch_size=1, seed=0)
        self.spec = env.world
        env.close()

    def make_env(
        self,
        *,
        batch_size: int,
        seed: int,
        privileged: bool = False,
        episode_length: int | None = None,
    ) -> EnvBase:
        """A batch of environments; ``privileged`` adds nothing here."""
        with refusing("world.id: "):
            return make_pixel_env(
                self.config.id,
                batch_size=batch_size,
                episode_length=episode_length or self.episode_length,
                seed=seed,
                render=self.config.render,
            )
