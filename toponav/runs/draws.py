"""Settings drawn by chance: `log_uniform` in a command line, plain numbers in a run."""

import math
import random
import re
from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from toponav.config import require
from toponav.runs.files import write_text

#: Beside the settings of a run: those that were drawn, and their numbers.
DRAWS_FILE = "draws.yaml"


def log_uniform(low: float, high: float, *, _root_: DictConfig) -> float:
    """A number whose logarithm is uniform, drawn by the run's seed; four digits.

    A command line writes it ``'loss.lr=${log_uniform:1e-4,5e-3}'``. The same seed and
    bounds give the same number; other bounds another one.

    Reference:
        The paper, "Hyperparameters".

    Raises:
        SettingsError: unless ``0 < low <= high``, both finite.

    Examples:
        >>> log_uniform(1e-4, 5e-3, _root_=OmegaConf.create({"seed": 7}))
        0.0001107
    """
    good = all(isinstance(one, int | float) for one in (low, high))
    good = good and 0 < low <= high < math.inf
    rule = "log_uniform must have two bounds, above 0 and the lower one first"
    require(good, rule, f"{low},{high}")
    share = random.Random(f"{_root_.seed} {low:g} {high:g}").random()
    return float(f"{low * math.exp(share * math.log(high / low)):.4g}")


def keep_draws(folder: Path, config: DictConfig, words: Sequence[str]) -> None:
    """Write what was drawn into the settings that Hydra saved in ``folder``.

    ``words`` are the command line of ``config``; to resume or to report takes no draw.
    """
    kept, drawn = list(words), dict[str, float]()
    for at, word in enumerate(kept):
        name, _, value = word.lstrip("+").partition("=")
        if re.search(r"\$\\?\{log_uniform\\?:", value):
            drawn[name] = OmegaConf.select(config, name)
            OmegaConf.update(config, name, drawn[name])
            kept[at] = f"{name}={drawn[name]}"
    if drawn:
        files = {"config.yaml": config, "overrides.yaml": kept, DRAWS_FILE: drawn}
        for file, content in files.items():
            write_text(folder / file, OmegaConf.to_yaml(content))
