"""The settings of an exploration, read from its run folder."""

from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from toponav.config import ExploreConfig, read_yaml, refusing, require
from toponav.methods.learners import LEARNERS
from toponav.methods.rewards import REWARDS
from toponav.methods.worlds import WORLDS

_METHODS: dict[str, Any] = {"loss": LEARNERS, "reward": REWARDS, "world": WORLDS}


def read_explored(folder: str, *, setting: str) -> ExploreConfig:
    """The settings that an exploration was made with.

    Raises:
        SettingsError: if it is no folder of an exploration of this version; the
            sentence names the ``setting`` that has the folder.
    """
    file = Path(folder) / "config" / "config.yaml"
    rule = f"{setting} must name the folder of an exploration"
    require(file.is_file(), rule, f"'{folder}'")
    config = read_yaml(file)
    schema = OmegaConf.structured(ExploreConfig)
    rule += " of this version"
    for group, methods in _METHODS.items():
        name = OmegaConf.select(config, f"{group}.name")
        require(name in methods, rule, f"'{folder}', with {group}={name}")
        schema[group] = OmegaConf.structured(methods[name].schema)
    with refusing(f"{rule}, got '{folder}': ", (OmegaConfBaseException,)):
        found: Any = OmegaConf.to_object(OmegaConf.merge(schema, config))
    assert isinstance(found, ExploreConfig)
    return found
