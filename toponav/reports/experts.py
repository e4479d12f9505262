"""What policies do that do not learn: the blind baselines, and an expert."""

import json
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

import torch
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv

from toponav import keys
from toponav.builders import World, seed_of
from toponav.config import ExploreConfig
from toponav.policies import FrontierExpert
from toponav.reports.baselines import (
    baselines_content,
    baselines_file,
    find_baselines,
    play_baselines,
    read_kept,
)
from toponav.reports.episodes import play_episodes
from toponav.reports.exploration_evaluation import (
    BASELINES,
    EVALUATION_SEED,
    Evaluation,
)
from toponav.runs import locked, remove_halves_of, write_text
from toponav.training import Row, make_coverage

FRONTIER = "frontier"
#: All policies of this file, by their names in tables.
SCRIPTED = (*BASELINES, FRONTIER)


def scripted_rows(
    settings: ExploreConfig, world: World, names: Sequence[str], *, play: bool = True
) -> list[Row]:
    """Episodes of scripted policies in a maze, as rows of ``evaluation.csv``.

    They are found where an earlier run kept them, or played and kept if ``play``.
    """
    rows: list[Row] = []
    if set(names) & set(BASELINES):
        find = play_baselines if play else find_baselines
        rows += find(settings, world) or []
    if FRONTIER in names:
        rows += _frontier(settings, world, play=play)
    return [row for row in rows if row["policy"] in names]


def _frontier(settings: ExploreConfig, world: World, *, play: bool) -> list[Row]:
    """The expert that knows the maze and goes to the nearest cell not yet visited.

    Another process that plays the same episodes is waited for.
    """
    file = baselines_file(settings, world)
    file = file.with_name(f"{file.stem}-{FRONTIER}.json")
    find, rows = partial(read_kept, file, settings, world, [FRONTIER]), None
    if not play:
        return find() or []
    with suppress(OSError), locked(file.with_name(f".{file.stem}.lock")):
        remove_halves_of(file)
        if (rows := find()) is None:
            rows, is_whole = _play(settings, world)
            if is_whole:
                content = {"of": baselines_content(settings, world), "rows": rows}
                write_text(file, json.dumps(content, indent=1))
    return rows or _play(settings, world)[0]


def _play(settings: ExploreConfig, world: World) -> tuple[list[Row], bool]:
    """The rows, and whether no episode was cut short by the loss of an engine."""
    assert world.layout is not None
    seed = settings.evaluate.random_seed

    def make_env(envs: int) -> EnvBase:
        env = world.make_env(batch_size=envs, seed=0, privileged=True)
        return TransformedEnv(env, Compose(make_coverage(world), InitTracker()))

    expert = FrontierExpert(
        torch.as_tensor(world.layout.open_mask),
        world=world.spec,
        slot_cells=list(world.layout.slots.values()),
        seed=seed,
    )
    played = play_episodes(
        make_env,
        {FRONTIER: expert},
        {FRONTIER: settings.evaluate.random_episodes},
        world.episode_length,
        seed=seed_of(seed, EVALUATION_SEED),
        keep=[],
        keep_next=[keys.COVERAGE, keys.DECISIONS_TO_COVERAGE, keys.TRUNCATED],
        views=0,
    )[FRONTIER]
    one = Evaluation(FRONTIER, played.frames, played.views, keys.INTRINSIC_REWARD)
    cut = one.episodes["next", keys.TRUNCATED][:, :-1].any()
    return one.rows(), not cut
