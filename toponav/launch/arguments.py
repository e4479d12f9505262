"""Command lines as users type them, and as Hydra gets them."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf

from toponav.config import RECIPES, SettingsError, read_yaml, require
from toponav.methods import METHODS
from toponav.refusals import leaves, methods_of, settings_of, unknown_setting

#: Most bytes of the name of a sweep's folder; file systems allow 255.
_LONGEST_NAME = 200
#: The settings, and groups of them, that choose a world.
_WORLD = ("maze", "mazes", "engine", "world")
#: Hydra's flags that have a value.
_FLAGS = (
    *("--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun"),
    *("--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"),
)


def folder_name(overrides: str) -> str:
    """One folder's name for the overrides of a run of a sweep, joined by commas.

    Nothing in it makes folders of its own or needs quotes in a shell; a long one ends
    in a digest. YAML writes it ``${folder_name:${hydra.job.override_dirname}}``.

    Examples:
        >>> folder_name("maze.blocked=[a,b],init_from=/runs/select")
        'maze.blocked=a,b,init_from=-runs-select'
    """
    bare = re.sub(r"[][{}$'\"\\]", "", overrides)
    name = re.sub(r"[^\w.,=+-]+", "-", bare)
    if len(name.encode()) > _LONGEST_NAME:
        digest = hashlib.sha256(overrides.encode()).hexdigest()[:8]
        # Letters may take several bytes: half of one is left out.
        begin = name.encode()[: _LONGEST_NAME - 9].decode(errors="ignore")
        name = f"{begin}-{digest}"
    return name


def resumed_arguments(arguments: list[str], recipe: str) -> list[str]:
    """The command line of the run to go on with, and its folder to write into.

    A command line without ``resume=`` comes back as it is.

    Raises:
        SettingsError: if ``resume`` names no run folder, or that of an earlier version
            or another recipe, with settings that ``recipe`` has not; or if the world
            is to be another one.
    """
    given = [word for word in arguments if word.startswith("resume=")]
    folder = _bare(given[-1].partition("=")[2]) if given else ""
    if folder in ("", "null"):
        return arguments
    overrides = Path(folder) / "config" / "overrides.yaml"
    if not overrides.is_file():
        raise SettingsError(f"resume must name the folder of a run, got '{folder}'")
    config = overrides.with_name("config.yaml")
    known = set(settings_of(RECIPES[recipe]))
    for group, schemas in METHODS.items():
        known.update(*(settings_of(schema, f"{group}.") for schema in schemas.values()))
    old = OmegaConf.to_container(read_yaml(config)) if config.is_file() else {}
    other = next((key for key in leaves(old) if key not in known), None)
    require(
        other is None,
        f"resume must name a run of {recipe} of this version",
        f"'{folder}', which an earlier version (or another recipe) made with other "
        f"settings, '{other}'",
    )
    first: Any = OmegaConf.to_container(read_yaml(overrides, ListConfig))
    rule = "resume must name a run whose command line was kept whole"
    whole = all(isinstance(word, str) and word[:1] not in ("", "=") for word in first)
    require(whole, rule, f"'{overrides}'")
    # What was learned, mapped and counted is of that world.
    rule = "resume must go on in the world of its run, without settings of another one"
    for word in arguments:
        name = re.match(r"[+~]*(\w+)", word)
        is_other = name is not None and name[1] in _WORLD and word not in first
        require(not is_other, rule, f"'{word}'")
    kept = [word for word in first + arguments if not word.startswith("resume=")]
    return [*kept, *(f"{key}={_quoted(folder)}" for key in ("resume", "hydra.run.dir"))]


def quote_names(arguments: Sequence[str], conf: Path) -> list[str]:
    """The command line with other values of groups of settings as names in quotes.

    Hydra refuses a name that a group does not have in a sentence, and what is no name,
    such as ``maze=3``, with a traceback.

    Args:
        arguments: the command line.
        conf: the folder of the groups.

    Examples:
        >>> quote_names(["seed=3", "maze=3", "-m", "loss=ppo,7"], Path("conf"))
        ['seed=3', "maze='3'", '-m', "loss='ppo','7'"]
    """
    words = list(arguments)
    for number, word in enumerate(words):
        group, equals, given = word.partition("=")
        if not equals or not (conf / group.lstrip("+~")).is_dir():
            continue
        try:
            (one,) = OverridesParser.create().parse_overrides([word])
        except HydraException:  # which is told elsewhere
            continue
        is_sweep = one.is_choice_sweep()
        if one.is_sweep_override() and not is_sweep:
            continue
        values = list(one.sweep_iterator()) if is_sweep else [one.value()]
        if not all(isinstance(value, str) for value in values):
            parts = given.split(",") if is_sweep else [given]
            words[number] = f"{group}=" + ",".join(_quoted(part) for part in parts)
    return words


def require_own_subdir(arguments: Sequence[str], conf: Path) -> None:
    """Refuse a command line by which a run keeps its settings elsewhere, or nowhere.

    Its lock lies beside them, and resuming and reports look for them there.

    Args:
        arguments: the command line.
        conf: the recipe's own file; where it keeps none, nothing is refused.

    Raises:
        SettingsError: if ``hydra.output_subdir`` is another one than in ``conf``.
    """
    # Also `hydra={output_subdir:null}`.
    words = [word for word in arguments if re.match(r"[+~]*hydra[.=]", word)]
    if not words:
        return
    own = OmegaConf.select(OmegaConf.load(conf), "hydra.output_subdir")
    for one in OverridesParser.create().parse_overrides(words):
        name, several = one.key_or_group, one.is_sweep_override()
        value = None if several else one.value()
        if name == "hydra" and isinstance(value, dict) and "output_subdir" in value:
            name, value = "hydra.output_subdir", value["output_subdir"]
        if name == "hydra.output_subdir" and own is not None:
            given = "null" if value is None else f"'{value}'"
            rule = f"{name} must be '{own}', where a run keeps its settings"
            require(value == own, rule, "several" if several else given)


def require_known(cfg: DictConfig, words: Sequence[str], recipe: str) -> None:
    """Refuse settings that a recipe does not have, or not in its world.

    Args:
        cfg: what Hydra composed.
        words: the command line.
        recipe: a key of ``RECIPES``.

    Raises:
        SettingsError: that names the first one.
    """
    world = OmegaConf.select(cfg, "world.name", default="maze")
    for word in words:
        key = word.lstrip("+~").partition("=")[0]
        of_maze = re.match(r"(maze|engine|pretraining\.maze)\b", key)
        good = world == "maze" or not of_maze
        require(good, f"'{key}' must go with world=maze", f"world={world}")
    for key in leaves(OmegaConf.to_container(cfg)):
        if unknown := unknown_setting(key, recipe, methods_of(cfg)):
            raise SettingsError(unknown)


def named_folder(arguments: list[str], name: str) -> list[str]:
    """The command line with the name of a setting before the folder that stands alone.

    What is an existing folder, or has neither a ``=`` nor a leading dash, is taken for
    the folder, unless it is the value of one of Hydra's flags.

    Examples:
        >>> named_folder(["multirun/explore"], "folder")
        ["folder='multirun/explore'"]
    """
    found = []
    for before, word in zip(["", *arguments], arguments, strict=False):
        given = word.removeprefix(f"{name}=")
        alone = Path(word).is_dir() or not ("=" in word or word.startswith("-"))
        alone = alone and before not in _FLAGS
        found.append(f"{name}={_quoted(given)}" if given != word or alone else word)
    return found


def _quoted(folder: str) -> str:
    """In quotes for Hydra: a sweep's folder has equals signs and commas in its name."""
    return "'" + _bare(folder).replace("'", "\\'") + "'"


def _bare(folder: str) -> str:
    """Without the quotes around it, in which Hydra's grammar escapes others."""
    quoted = re.fullmatch(r"(['\"])(.*)\1", folder, re.DOTALL)
    if quoted is None:
        return folder
    return quoted[2].replace(f"\\{quoted[1]}", quoted[1])
