"""Settings of an experiment, composed as the recipe composes them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from toponav.config import ReproduceConfig
from toponav.launch import folder_name
from toponav.methods import register
from toponav.runs import log_uniform

CONF = Path(__file__).parents[2] / "conf"


@contextmanager
def reproducing(*words: str) -> Iterator[ReproduceConfig]:
    """In the block, other recipes' settings can be composed as well."""
    register()
    for resolver in (folder_name, log_uniform):
        OmegaConf.register_new_resolver(resolver.__name__, resolver, replace=True)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield OmegaConf.to_object(compose("reproduce", overrides=list(words)))
