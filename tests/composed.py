"""Settings of a recipe's command line; what can be shared is composed once."""

import copy
import re
from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from toponav.launch import folder_name
from toponav.methods import register
from toponav.runs import log_uniform

CONF = Path(__file__).parent.parent / "conf"


def settings(recipe: str, *overrides: str) -> object:
    """What a recipe makes of its command line."""
    return OmegaConf.to_object(composed(recipe, *overrides))


def composed(recipe: str, *overrides: str) -> DictConfig:
    """What Hydra composes, as a copy that is the caller's own.

    Composing is slow, and values change nothing about which files it reads: Hydra puts
    them in at the end, with the same two calls as here. What it would refuse, or is
    more than a value, it gets to see.
    """
    values = [word for word in overrides if is_value(word)]
    chosen = [word for word in overrides if word not in values]
    config = copy.deepcopy(_composed(recipe, *chosen))
    try:
        parsed = OverridesParser.create().parse_overrides(values) if values else []
        if any(one.is_sweep_override() for one in parsed):
            return by_hydra(recipe, *overrides)
        for one in parsed:
            OmegaConf.update(config, one.key_or_group, one.value(), merge=True)
    except (HydraException, OmegaConfBaseException):
        return by_hydra(recipe, *overrides)
    return config


def is_value(word: str) -> bool:
    """Whether it gives one setting a value, and chooses no option of a group."""
    name, _, _ = word.partition("=")
    plain = re.fullmatch(r"(?!hydra\b)\w+(\.\w+)*", name)
    return "=" in word and plain is not None and not (CONF / name).is_dir()


def by_hydra(recipe: str, *overrides: str) -> DictConfig:
    """What Hydra composes, by itself."""
    register_once()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose(recipe, overrides=list(overrides))


@cache
def register_once() -> None:
    """As the recipes do; it takes a fifth of what composing does."""
    register()
    for resolver in (folder_name, log_uniform):
        OmegaConf.register_new_resolver(resolver.__name__, resolver, replace=True)


_composed = cache(by_hydra)
