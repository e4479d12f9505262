"""Settings of an experiment, composed as the recipe composes them."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from unittest.mock import patch

from hydra import initialize_config_dir
from omegaconf import DictConfig

from tests.composed import CONF as CONF, composed, settings
from toponav.config import ReproduceConfig
from toponav.experiments import cells


def from_shared(recipe: str, overrides: Sequence[str]) -> DictConfig:
    """Hydra's `compose`, in much less time for rows that choose what others chose."""
    return composed(recipe, *overrides)


@contextmanager
def reproducing(*words: str, by_hydra: bool = False) -> Iterator[ReproduceConfig]:
    """In the block, other recipes' settings can be composed as well.

    Args:
        words: the command line.
        by_hydra: whether Hydra itself composes these, as in the recipe.
    """
    found = settings("reproduce", *words)
    assert isinstance(found, ReproduceConfig)
    with (
        initialize_config_dir(str(CONF), version_base="1.3")
        if by_hydra
        else patch.object(cells, "compose", from_shared)
    ):
        yield found
