"""Blind baselines: what policies do that see nothing, and exploring must beat."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase, TransformedEnv
from tqdm import tqdm

from toponav import keys
from toponav.builders import World, make_walk_policy, seed_of, settings_key
from toponav.config import ExploreConfig
from toponav.envs import EngineError
from toponav.reports.beside import FEW, Beside, BesideError
from toponav.reports.episodes import play_episodes
from toponav.reports.exploration_evaluation import (
    BASELINES,
    EVALUATION_SEED,
    Evaluation,
    evaluate_policies,
)
from toponav.runs import locked, remove_halves_of, require_room, write_text
from toponav.training import Explorer, Row, make_coverage, mean_of

# To be raised if policies, scenes or what counts as covered change.
_VERSION = 1
# Settings of a maze that change nothing for who sees nothing; the path is only that of
# the layout, whose text counts.
_UNSEEN = ("path", "texture_seed", "paintings", "marks")
# Room for what is kept, in MB.
_KEPT_MB = 1.0


class Baselines:
    """The episodes of the blind baselines of a run, as rows of ``evaluation.csv``.

    In a maze they depend on the engine, the maze, their seed, number and length alone.
    So they are kept, in ``evaluate.random_folder``, and found again by later runs; if
    they are missing, `start` plays them beside the run. In worlds without ground truth
    they are judged by the explorer's reward, and played in `rows`.
    """

    def __init__(self, settings: ExploreConfig, world: World) -> None:
        self.settings, self.world = settings, world
        self.beside: Beside[None] | None = None
        self._kept: list[Row] | None = None

    def start(self) -> None:
        """Play what is missing in a process of the lowest priority, if it is much."""
        evaluate, length = self.settings.evaluate, self.world.episode_length
        few = len(BASELINES) * evaluate.random_episodes * length < FEW
        if self.world.layout is None or few or self._find() is not None:
            return
        # One that cannot start costs nothing: `rows` plays them.
        with suppress(BesideError):
            self.beside = Beside(_play_missing, self.settings, self.world, nice=19)

    def levels(self) -> dict[str, float]:
        """Mean coverage of each, by name; empty as long as it is unknown."""
        rows = (self._find() if self.world.layout is not None else None) or []
        names = dict.fromkeys(str(row["policy"]) for row in rows)
        return {
            name: mean_of([row for row in rows if row["policy"] == name], "coverage")
            for name in names
        }

    def rows(self, settings: ExploreConfig, explorer: Explorer) -> list[Row]:
        """All episodes; waits for the process, and plays what it has not played.

        The ``settings`` are those of the explorer, with the model of its networks.
        """
        world = self.world
        if world.layout is None:
            policies = make_baselines(world, seed=settings.seed)
            played = evaluate_policies(settings, world, explorer, policies)
            return [row for one in played for row in one.rows()]
        self._wait()
        rows = self._find()
        return play_baselines(settings, world) if rows is None else rows

    def _find(self) -> list[Row] | None:
        if self._kept is None:
            self._kept = find_baselines(self.settings, self.world)
        return self._kept

    def _wait(self) -> None:
        if self.beside is None:
            return
        if self.beside.is_running and self._find() is None:
            tqdm.write("waiting for the blind baselines")
        try:
            self.beside.result()
        except BesideError as error:
            tqdm.write(
                f"the blind baselines must be played beside the run, got: {error}; "
                "they are played now"
            )
        self.beside = None


def start_baselines(settings: ExploreConfig, world: World) -> Baselines:
    """The blind baselines of a run, which a process plays if they are missing.

    Raises:
        SettingsError: if they cannot be kept where later runs would find them.
    """
    baselines = Baselines(settings, world)
    if world.layout is not None and find_baselines(settings, world) is None:
        kept = Path(settings.evaluate.random_folder)
        require_room(kept, "evaluate.random_folder", _KEPT_MB)
    baselines.start()
    return baselines


def make_baselines(world: World, *, seed: int) -> dict[str, TensorDictModuleBase]:
    """Policies that see nothing: uniform, and one that mostly repeats its action."""
    kinds = dict(zip(BASELINES, ("uniform", "sticky"), strict=True))
    return {
        name: make_walk_policy(kind, world.spec, seed=seed)
        for name, kind in kinds.items()
    }


def play_baselines(settings: ExploreConfig, world: World) -> list[Row]:
    """Play the blind baselines of a maze and keep them; another run's are waited for.

    They are not kept where they cannot be, nor if an engine was lost meanwhile.
    """
    file, rows = baselines_file(settings, world), None
    with suppress(OSError), locked(file.with_name(f".{file.stem}.lock")):
        remove_halves_of(file)
        if (rows := find_baselines(settings, world)) is None:
            rows, is_whole = _play(settings, world)
            if is_whole:
                content = {"of": baselines_content(settings, world), "rows": rows}
                write_text(file, json.dumps(content, indent=1))
    return rows or _play(settings, world)[0]


def find_baselines(settings: ExploreConfig, world: World) -> list[Row] | None:
    """The rows that were kept; ``None`` without any, or if the file is damaged."""
    return read_kept(baselines_file(settings, world), settings, world, BASELINES)


def read_kept(
    file: Path, settings: ExploreConfig, world: World, policies: Sequence[str]
) -> list[Row] | None:
    """The rows that a file keeps of these policies; ``None`` if it is damaged."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        rows: list[Row] = found["rows"]
        played = [(row["policy"], row["seed"]) for row in rows]
        covered = [0 <= row["coverage"] <= 1 for row in rows]
        is_same = found["of"] == baselines_content(settings, world)
        # Those of the last row become those of the run's table.
        columns = {tuple(row) for row in rows}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    episodes = range(settings.evaluate.random_episodes)
    wanted = [(name, number) for name in policies for number in episodes]
    is_whole = played == wanted and all(covered) and len(columns) <= 1
    return rows if is_same and is_whole else None


def baselines_file(settings: ExploreConfig, world: World) -> Path:
    """Where the blind baselines of a maze are kept; its name has their key."""
    name = f"{world.name}-{settings_key(baselines_content(settings, world))}.json"
    return Path(settings.evaluate.random_folder) / name


def baselines_content(settings: ExploreConfig, world: World) -> dict[str, object]:
    """All that the episodes of scripted policies depend on."""
    assert world.layout is not None
    maze = asdict(settings.maze)
    return {
        "version": _VERSION,
        "engine": settings.engine,
        "world": asdict(settings.world),
        "maze": {name: maze[name] for name in maze if name not in _UNSEEN},
        "layout": world.layout.text,
        "seed": settings.evaluate.random_seed,
        "episodes": settings.evaluate.random_episodes,
    }


def _play_missing(_: object, settings: ExploreConfig, world: World) -> None:
    """What the process beside the run does."""
    play_baselines(settings, world)
    if find_baselines(settings, world) is None:
        raise EngineError(f"{baselines_file(settings, world)} could not be written")


def _play(settings: ExploreConfig, world: World) -> tuple[list[Row], bool]:
    """The rows, and whether no episode was cut short by the loss of an engine."""
    seed = settings.evaluate.random_seed

    def make_env(envs: int) -> EnvBase:
        env = world.make_env(batch_size=envs, seed=0, privileged=True)
        return TransformedEnv(env, make_coverage(world))

    played = play_episodes(
        make_env,
        make_baselines(world, seed=seed),
        dict.fromkeys(BASELINES, settings.evaluate.random_episodes),
        world.episode_length,
        seed=seed_of(seed, EVALUATION_SEED),
        keep=[],
        keep_next=[keys.COVERAGE, keys.DECISIONS_TO_COVERAGE, keys.TRUNCATED],
        views=0,
    )
    evaluations = [
        Evaluation(name, one.frames, one.views, keys.INTRINSIC_REWARD)
        for name, one in played.items()
    ]
    cut = [one.episodes["next", keys.TRUNCATED][:, :-1].any() for one in evaluations]
    return [row for one in evaluations for row in one.rows()], not any(cut)
