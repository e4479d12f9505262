"""Any Gymnasium environment with pixels and discrete actions."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, fields
from typing import Any

from omegaconf import MISSING, OmegaConf
from torchrl.envs import EnvBase

from toponav.builders import World
from toponav.config import (
    ExploreConfig,
    PretrainConfig,
    WorldConfig,
    a_seed,
    above,
    refusing,
    require,
)
from toponav.envs import GymChoices, make_pixel_env


@dataclass
class GymWorldConfig(WorldConfig):
    """Settings of ``world=gym``."""

    id: str = MISSING
    render: bool = MISSING
    options: list[str] = field(default_factory=list)
    wrappers: list[str] = field(default_factory=list)
    view: str | None = MISSING
    actions: list[int] = field(default_factory=list)
    reset_seed: int | None = a_seed()
    position: list[str] = field(default_factory=list)
    square: float = above(0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read_options()

    @property
    def choices(self) -> GymChoices:
        """What is done with the environment before anybody sees it."""
        names = [choice.name for choice in fields(GymChoices)]
        given = {name: getattr(self, name) for name in names}
        return GymChoices(**(given | {"options": self._read_options()}))

    def _read_options(self) -> dict[str, Any]:
        """Names and values of `options`."""
        read: dict[str, Any] = {}
        for option in self.options:
            found: Any = None
            # What is no YAML makes its reader fail in any way.
            with suppress(Exception):
                text = option.replace(":", ": ", 1)
                found = OmegaConf.to_container(OmegaConf.create(text))
            rule = "world.options must hold entries such as max_steps:500"
            require(":" in option and isinstance(found, dict), rule, f"'{option}'")
            read |= found
        return read


class GymWorld(World):
    """A Gymnasium environment with pixels and discrete actions.

    There is no ground truth but the position that ``position`` names, if it does.
    """

    schema = GymWorldConfig
    senses = ()

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
        senses: Collection[str] = (),
    ) -> EnvBase:
        """A batch of environments; ``privileged`` adds the position, if any."""
        with refusing("world.id: "):
            return make_pixel_env(
                self.config.id,
                batch_size=batch_size,
                episode_length=episode_length or self.episode_length,
                seed=seed,
                choices=self.config.choices,
                privileged=privileged,
            )
