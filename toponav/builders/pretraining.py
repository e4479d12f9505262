"""Networks to explore with: given, reused, or trained now."""

import fcntl
import hashlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import IO

from omegaconf import OmegaConf
from tqdm import tqdm

from toponav.builders.mazes import make_layout
from toponav.builders.networks import (
    NETWORKS_FILE,
    Networks,
    load_networks,
    networks_path,
    save_networks,
)
from toponav.builders.protocols import World
from toponav.config import (
    ExploreConfig,
    MazeConfig,
    Settings,
    SettingsError,
    TrainingError,
    maze_label,
    read_yaml,
    require,
)
from toponav.envs import DEFAULT_ENGINE, end_stray_engines
from toponav.runs import CHECKPOINT_FILE, IdleWatch, is_at, remove_unused

_WAIT_S = 20
# Seconds without any processor time after which a pre-training hangs.
_IDLE_S = 600.0
# Exit status of a recipe that was refused, by a sentence that it printed.
_REFUSED = 2


def prepare_networks(
    config: ExploreConfig,
    world: World,
    folder: Path,
    script: Path,
    *,
    environment: Mapping[str, str] | None = None,
) -> Networks:
    """Networks for a run, copied into its folder.

    In this order: those that the run already has, if it resumes; those of
    ``pretrained``; those of an earlier pre-training with the same settings; those of a
    pre-training that starts now by ``script``, which a later run finds; it gets the
    variables of ``environment``.

    Raises:
        SettingsError: if ``pretrained`` names no usable networks, or the pre-training
            refuses its settings.
        TrainingError: if the pre-training fails.
    """
    load = partial(load_networks, world=world.spec)
    if config.resume and (folder / NETWORKS_FILE).is_file():
        return load(folder, setting="resume")
    if config.pretrained is not None:
        networks = load(config.pretrained, setting="pretrained")
    else:
        pretrained = pretrain(config, script, environment or {})
        networks = load(pretrained, setting="pretraining.folder")
    save_networks(networks, folder / NETWORKS_FILE)
    return networks


def pretrain(
    config: ExploreConfig, script: Path, environment: Mapping[str, str]
) -> Path:
    """The folder of a pre-training with these settings, finished.

    The folder's name has a key made of all settings that matter, and one process at a
    time works in it: another that wants the same waits. A pre-training that was cut
    off resumes.
    """
    overrides, folder = pretraining_overrides(config), pretraining_folder(config)
    # A folder that is shared may be one to read alone.
    if (folder / NETWORKS_FILE).is_file():
        tqdm.write(f"networks of {folder}")
        return folder
    with _alone_in(folder) as lock:
        if (folder / NETWORKS_FILE).is_file():  # another run's, meanwhile
            return folder
        tqdm.write(f"pre-training in {folder}")
        if (folder / CHECKPOINT_FILE).is_file():
            arguments = [f"resume={_in_hydra(str(folder))}"]
        else:
            arguments = [*overrides, f"hydra.run.dir={_in_hydra(str(folder))}"]
        try:
            _run([sys.executable, str(script), *arguments], lock, environment)
        except SettingsError:
            remove_unused(folder, {".lock", "config", f"{script.stem}.log"})
            raise
    if not (folder / NETWORKS_FILE).is_file():
        raise TrainingError(
            f"pre-training must end with networks, got none in {folder}"
        )
    return folder


def pretraining_decisions(config: ExploreConfig) -> float:
    """Decisions that the networks learned from before, as far as their runs say.

    A run says in its settings how many it collected and from which run it began; NaN if
    the settings of one are not found.
    """
    at = config.pretrained or str(pretraining_folder(config))
    decisions, seen = 0.0, set[str]()
    while at is not None and at not in seen:
        seen.add(at)
        path = networks_path(at)
        folder = path if path.is_dir() else path.parent
        file = folder / "config" / "config.yaml"
        if not file.is_file():
            return math.nan
        entries = read_yaml(file)
        collected = float(OmegaConf.select(entries, "collect.decisions", default=0))
        if "reward" not in entries:
            decisions += collected
            at = OmegaConf.select(entries, "init_from", default=None)
            continue
        # An exploration: its networks came from elsewhere, and may have trained more.
        if OmegaConf.select(entries, "online.learn"):
            decisions += collected
        if (at := OmegaConf.select(entries, "pretrained")) is None:
            return math.nan
    return decisions


def pretraining_folder(config: ExploreConfig) -> Path:
    """Where a pre-training with these settings is kept; its name has their key."""
    maze, content = pretraining_maze(config), pretraining_overrides(config)
    # Keys of earlier versions, which knew nothing else, are still valid.
    only = (f"engine={DEFAULT_ENGINE}", "pairs.locomotion_exact=false")
    content = [word for word in content if word not in only]
    key = settings_key([*content, *_read_content(config)])
    label = config.world.label
    if config.world.name == "maze":
        label = maze_label(maze.name, maze.path)
    return Path(config.pretraining.folder) / f"{label}-{config.pretraining.scale}-{key}"


def _read_content(config: ExploreConfig) -> Iterator[str]:
    """What is in the files of a pre-training: one may change under the same path."""
    maze, given = pretraining_maze(config), config.pretraining.given()
    if config.world.name == "maze" and "file" in (given.get("mazes") or [maze.name]):
        yield make_layout(replace(maze, name="file")).text
    if start := given.get("init_from"):
        path = networks_path(str(start), "init_from")
        file = path / NETWORKS_FILE if path.is_dir() else path
        # A run that is resumed needs them no more.
        if file.is_file():
            yield hashlib.sha256(file.read_bytes()).hexdigest()


def settings_key(content: object) -> str:
    """A short word for plain values, another one for others.

    Examples:
        >>> settings_key(["seed=0"]) == settings_key(["seed=1"])
        False
    """
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:8]


def pretraining_maze(config: ExploreConfig) -> MazeConfig:
    """The maze of the pre-training: another one has no slots of the same names."""
    given, maze = config.pretraining.given(), config.maze
    chosen = given.get("maze", config.pretraining.maze)
    name = str(given.get("maze.name", chosen) or maze.name)
    path = given.get("maze.path", maze.path if name == maze.name else None)
    blocked = maze.blocked if name == maze.name else []
    path = None if path is None else str(path)
    return replace(maze, name=name, path=path, blocked=blocked)


def pretraining_overrides(config: ExploreConfig) -> list[str]:
    """The command line of the pre-training: all that its result depends on."""
    maze, world = pretraining_maze(config), config.world
    groups: list[Settings] = [config.model, config.pairs, world]
    choices = [f"world={world.name}", f"scale={config.pretraining.scale}"]
    if world.name == "maze":
        groups = [maze, config.model, config.pairs]
        choices[0] = f"maze={maze.name}"
        choices.append(f"engine={config.engine}")
    values = [
        f"{settings.group}.{name}={_in_hydra(value)}"
        for settings in groups
        for name, value in asdict(settings).items()
    ]
    seed = f"seed={config.pretraining.seed}"
    return [*choices, *values, seed, *config.pretraining.overrides]


def _in_hydra(value: object) -> str:
    """A value in the grammar of Hydra's command line.

    Examples:
        >>> [_in_hydra(value) for value in (None, True, [1, 2], "a b")]
        ['null', 'true', '[1,2]', "'a b'"]
    """
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ",".join(_in_hydra(one) for one in value) + "]"
    if isinstance(value, str) and not value.isidentifier():
        return "'" + value.replace("'", "\\'") + "'"
    return str(value)


@contextmanager
def _alone_in(folder: Path) -> Iterator[IO[str]]:
    """Hold the folder's lock; it falls with the last process that has it open."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / ".lock").open("w") as lock:
            _wait_for(lock, folder)
            # Who had it may have been refused, and have removed it with the folder.
            if is_at(folder / ".lock", lock):
                yield lock
                return


def _wait_for(lock: IO[str], folder: Path) -> None:
    for attempt in count():
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if attempt == 1:
                tqdm.write(f"waiting for another run that pre-trains in {folder}")
            # Engines have it open too, and outlive a pre-training that is killed.
            end_stray_engines()
            time.sleep(min(attempt, 1))


def _run(command: list[str], lock: IO[str], environment: Mapping[str, str]) -> None:
    """Run the recipe; it keeps the lock if this process is killed before it ends."""
    process = subprocess.Popen(
        command, pass_fds=[lock.fileno()], env={**os.environ, **environment}
    )
    # It watches its own processes, and ends before this if one of them hangs.
    watch = IdleWatch(process.pid, patience_s=_IDLE_S)
    try:
        while process.poll() is None and not watch.is_idle():
            with suppress(subprocess.TimeoutExpired):
                process.wait(watch.look_s)
        if process.poll() is None:
            rule = "pre-training must go on until it ends"
            raise TrainingError(f"{rule}, got no processor time in {_IDLE_S:g} s")
        status = process.returncode
    except BaseException:
        process.terminate()
        try:
            process.wait(_WAIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
        raise
    rule = "pre-training must have settings that it takes"
    require(status != _REFUSED, rule, f"exit status {status}")
    if status:
        raise TrainingError(f"pre-training must end well, got exit status {status}")
