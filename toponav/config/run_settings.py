"""Settings of an earlier run: of its ``config.yaml`` only what is asked for is read."""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from toponav.config.checks import SettingsError

_MISSING = object()


def run_setting(run: str | None, name: str, default: Any = _MISSING) -> Any:
    """A setting of the exploration in a run folder.

    YAML writes it ``${run_setting:${run},maze.name}``.

    Args:
        run: the folder.
        name: dotted name of the setting.
        default: without a run, and of earlier runs that had no such setting.

    Raises:
        SettingsError: if it is no folder of an exploration, or has no such setting.
    """
    if run is None and default is not _MISSING:
        return default
    if run is None:
        raise SettingsError("run must name the folder of an exploration, got none")
    file = Path(run) / "config" / "config.yaml"
    if not file.is_file():
        raise SettingsError(f"run must name the folder of an exploration, got '{run}'")
    config = OmegaConf.load(file)
    if not isinstance(config, DictConfig) or not {"maze", "reward"} <= config.keys():
        raise SettingsError(
            "run must name the folder of an exploration, got that of another recipe, "
            f"'{run}'"
        )
    value = OmegaConf.select(config, name, default=default)
    if value is _MISSING:
        raise SettingsError(f"run must name a run with the setting {name}, got '{run}'")
    return value
