"""`require_pretraining`: what a pre-training would refuse, before anything starts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra import compose
from omegaconf import OmegaConf

from toponav.builders import (
    NETWORKS_FILE,
    pretraining_folder,
    pretraining_overrides,
    start_networks,
)
from toponav.config import ExploreConfig, SettingsError
from toponav.launch.arguments import require_known
from toponav.methods import REWARDS, make_worlds
from toponav.refusals import REFUSALS, sentence_of

_RECIPE = "pretrain"


def require_pretraining(settings: ExploreConfig, folder: Path) -> None:
    """Refuse an exploration whose pre-training would refuse its settings.

    One that needs none, or finds one, passes.

    Args:
        settings: of the exploration.
        folder: of the exploration.

    Raises:
        SettingsError: that names ``pretraining.overrides`` if they are the reason.
    """
    if not REWARDS[settings.reward.name].needs_networks or settings.pretrained:
        return
    if settings.resume and (folder / NETWORKS_FILE).is_file():
        return
    if (error := _refusal(settings)) is None:
        return
    name, own = "pretraining", settings.pretraining
    if own.overrides:
        without = replace(settings, pretraining=replace(own, overrides=[]))
        name = name if _refusal(without) else f"{name}.overrides"
    rule = f"{name} must be settings that {_RECIPE} takes"
    raise SettingsError(f"{rule}: {sentence_of(error, _RECIPE)}") from error


def _refusal(settings: ExploreConfig) -> Exception | None:
    """What the pre-training of these settings would end with."""
    try:
        words = pretraining_overrides(settings)
        # Composing takes a third of a second.
        if (pretraining_folder(settings) / NETWORKS_FILE).is_file():
            return None
        composed = compose(_RECIPE, overrides=words)
        require_known(composed, words, _RECIPE)
        found: Any = OmegaConf.to_object(composed)
        world = make_worlds(found)[0].spec
        start_networks(found.model, world, found.init_from)
    except REFUSALS as error:
        return error
    return None
