"""Where frames come from: mazes, collectors, the storage, held-out episodes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, EnvBase, StepCounter, TransformedEnv
from torchrl.weight_update import NoWeightSyncScheme
from tqdm import tqdm

from toponav.builders.mazes import make_env
from toponav.builders.process_memory import keep_freed_memory
from toponav.builders.shutdown import stop_collector
from toponav.collectors import PatientAsyncCollector
from toponav.config import MazeConfig, PretrainConfig
from toponav.data import HeldOut
from toponav.evaluation import RandomPolicy, StickyPolicy
from toponav.keys import ACTION, CELL, HEADING, PIXELS, POSITION, TRAJECTORY
from toponav.transforms import AreaDownsample

#: What of a frame is kept for training.
FRAME_KEYS = (PIXELS, ACTION, TRAJECTORY, "step_count")
#: What of a held-out frame is kept; the poses are for the report alone.
HELD_OUT_KEYS = (PIXELS, ACTION, POSITION, HEADING, CELL)
# Seeds of one run lie in one block; training and validation in their own parts.
_SEEDS_PER_RUN = 1000
_FIRST_HELD_OUT_SEED = 900


def split_mazes(config: PretrainConfig) -> list[MazeConfig]:
    """The mazes of a run, one setting each.

    Raises:
        SettingsError: if ``mazes`` names one that the package does not have.
    """
    if not config.mazes:
        return [config.maze]
    return [replace(config.maze, name=name) for name in config.mazes]


def make_walk_env(
    maze: MazeConfig, *, envs: int, seed: int, halve: bool, privileged: bool = False
) -> EnvBase:
    """A batch of mazes to walk in at random, with the step number of each frame.

    Args:
        maze: the maze.
        envs: number of mazes E side by side.
        seed: of the episodes.
        halve: whether views are halved.
        privileged: whether to give the truth that evaluation needs.
    """
    # One process, one core: threads of torch would only get in each other's way.
    torch.set_num_threads(1)
    keep_freed_memory()
    return add_walk_transforms(
        make_env(maze, batch_size=envs, seed=seed, privileged=privileged), halve=halve
    )


def add_walk_transforms(env: EnvBase, *, halve: bool) -> EnvBase:
    """The step number, and smaller views if wanted."""
    transforms = [AreaDownsample()] if halve else []
    return TransformedEnv(env, Compose(*transforms, StepCounter()))


def make_walk_policy(kind: str, *, seed: int) -> TensorDictModuleBase:
    """Who walks: ``uniform`` or ``sticky``."""
    if kind == "sticky":
        return StickyPolicy(seed=seed)
    return RandomPolicy(seed=seed)


def make_collector(config: PretrainConfig) -> PatientAsyncCollector:
    """Processes that walk in the mazes while the caller does something else.

    Each hands over batches of ``collect.batch`` decisions and stays at most one batch
    ahead. One process gives the same frames in the same order every time; several
    take turns as they come. Shut it down in ``finally``; never ask it for its state
    while it runs (it would drop a rollout and hang).

    Args:
        config: settings of the run.

    Raises:
        EngineError: from the first batch, if the engine cannot start.
    """
    mazes, collect = split_mazes(config), config.collect
    num_workers = -(-max(collect.workers, len(mazes)) // len(mazes)) * len(mazes)
    seeds = [_SEEDS_PER_RUN * config.seed + worker for worker in range(num_workers)]
    return PatientAsyncCollector(
        [
            partial(
                make_walk_env,
                mazes[worker % len(mazes)],
                envs=collect.envs,
                seed=seed,
                halve=config.halve,
            )
            for worker, seed in enumerate(seeds)
        ],
        policy_factory=[
            partial(make_walk_policy, collect.policy, seed=seed) for seed in seeds
        ],
        frames_per_batch=collect.batch,
        total_frames=-1,
        compact_obs=True,
        # Without it, TorchRL leaves this process one thread less for every worker.
        num_threads=torch.get_num_threads(),
        weight_sync_schemes={"policy": NoWeightSyncScheme()},
        auto_register_policy_transforms=False,
    )


@contextmanager
def collect_frames(
    config: PretrainConfig, *, needed: bool = True
) -> Iterator[Iterator[TensorDictBase]]:
    """Batches of frames of a `make_collector` that ends with the ``with`` block.

    Args:
        config: settings of the run.
        needed: whether there is anything to collect; without, no process is started.
    """
    if not needed:
        yield iter(())
        return
    collector = make_collector(config)
    try:
        yield iter(collector)
    finally:
        stop_collector(collector)


def make_frame_buffer(config: PretrainConfig) -> TensorDictReplayBuffer:
    """The ring of frames: ``buffer.extend`` writes, pair sources read its storage."""
    storage = LazyTensorStorage(config.buffer)
    return TensorDictReplayBuffer(storage=storage, batch_size=config.collect.batch)


def collect_held_out(config: PretrainConfig, maze: MazeConfig, index: int) -> HeldOut:
    """Random episodes that no training sees, with the poses beside them.

    The actions are uniform whatever policy the training walks with, so that figures
    of different runs compare.

    Args:
        config: settings of the run.
        maze: the maze.
        index: the maze's number in the run; with the seed it draws the episodes.

    Raises:
        EngineError: if the engine cannot start.
    """
    validate = config.validate
    seed = _SEEDS_PER_RUN * config.seed + _FIRST_HELD_OUT_SEED + index
    maze = replace(maze, episode_length=validate.decisions)
    env = add_walk_transforms(
        make_env(maze, batch_size=validate.episodes, seed=seed, privileged=True),
        halve=config.halve,
    )
    step = min(validate.decisions, 60)
    collector = Collector(
        env,
        make_walk_policy("uniform", seed=seed),
        frames_per_batch=step * validate.episodes,
        total_frames=-1,
        compact_obs=True,
        auto_register_policy_transforms=False,
    )
    total = validate.episodes * validate.decisions
    parts: list[TensorDictBase] = []
    try:
        with tqdm(total=total, unit="decision", desc=f"held out {maze.name}") as bar:
            for frames in collector:
                parts.append(frames.select(*HELD_OUT_KEYS).clone())
                bar.update(min(frames.numel(), total - bar.n))
                if bar.n >= total:
                    break
    finally:
        stop_collector(collector)
    frames = torch.cat(parts, dim=1)[:, : validate.decisions]
    return HeldOut(frames, name=maze.name)
