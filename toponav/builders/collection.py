"""Where frames come from: collectors, rollouts, held-out episodes; their storage."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from typing import NamedTuple

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, EnvBase, StepCounter, TransformedEnv
from torchrl.envs.transforms import ExcludeTransform
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.weight_update import NoWeightSyncScheme
from tqdm import tqdm

from toponav.builders.processes import (
    collect_batches,
    prepare_process,
    start_collector,
    stop_collector,
)
from toponav.builders.protocols import World
from toponav.collectors import PatientAsyncCollector
from toponav.config import PretrainConfig
from toponav.data import HeldOut
from toponav.keys import (
    ACTION,
    DONE,
    HEADING,
    NETWORK_PIXELS,
    PIXELS,
    POSITION,
    TRAJECTORY,
)
from toponav.policies import RandomPolicy, StickyPolicy, forward_weights
from toponav.transforms import AreaDownsample
from toponav.worlds import WorldSpec

#: What of a frame is kept for training.
FRAME_KEYS = (NETWORK_PIXELS, ACTION, TRAJECTORY, "step_count")
#: What of a held-out frame is kept; poses, where there are any, are for the report.
HELD_OUT_KEYS = (NETWORK_PIXELS, ACTION, POSITION, HEADING)
# Seeds of one run lie in one block; training and validation in their own parts.
_SEEDS_PER_RUN = 1000
_FIRST_HELD_OUT_SEED = 900
# Seconds that a batch that is being taken may take when nobody needs it.
_TAKE_S = 5


def make_walk_env(world: World, *, envs: int, seed: int, halve: bool) -> EnvBase:
    """A batch of E environments for a collecting process."""
    # One process, one core: threads of torch would compete for it.
    prepare_process(threads=1)
    return add_walk_transforms(world.make_env(batch_size=envs, seed=seed), halve=halve)


def add_walk_transforms(env: EnvBase, *, halve: bool) -> EnvBase:
    """The views that the networks read, in place of the full ones; the step number."""
    shrink = AreaDownsample(factor=2 if halve else 1)
    return TransformedEnv(env, Compose(shrink, ExcludeTransform(PIXELS), StepCounter()))


def make_walk_policy(kind: str, world: WorldSpec, *, seed: int) -> TensorDictModuleBase:
    """A random policy: ``uniform``, or ``sticky``, which favours moving forward."""
    if kind == "sticky":
        weights = forward_weights(world)
        return StickyPolicy(world.num_actions, weights=weights, seed=seed)
    return RandomPolicy(world.num_actions, seed=seed)


@contextmanager
def collect_frames(
    config: PretrainConfig, worlds: Sequence[World], *, needed: bool = True
) -> Iterator[Iterator[TensorDictBase]]:
    """Batches of processes that walk at random, which end with the ``with`` block.

    Each delivers batches of ``collect.batch`` decisions and stays at most one batch
    ahead. One process gives the same frames in the same order every time; several
    deliver in any order. Without ``needed`` no process is started, and there are none.
    Raises `CollectionError` if a process dies or hangs, `EngineError` if none starts.
    """
    if not needed:
        yield iter(())
        return
    collect = config.collect
    make = partial(make_walk_env, envs=collect.envs, halve=config.model.halve)
    per_world = -(-max(collect.workers, len(worlds)) // len(worlds))
    workers = [
        (worlds[number % len(worlds)], _SEEDS_PER_RUN * config.seed + number)
        for number in range(per_world * len(worlds))
    ]
    # Never ask it for its state while it runs: it would drop a rollout and hang.
    start = partial(
        PatientAsyncCollector,
        [partial(make, world, seed=seed) for world, seed in workers],
        policy_factory=[
            partial(make_walk_policy, collect.policy, world.spec, seed=seed)
            for world, seed in workers
        ],
        frames_per_batch=collect.batch,
        total_frames=-1,
        compact_obs=True,
        # Without it, TorchRL leaves this process one thread less for every worker.
        num_threads=torch.get_num_threads(),
        weight_sync_schemes={"policy": NoWeightSyncScheme()},
        auto_register_policy_transforms=False,
    )
    collector = start_collector(start, max_idle_s=collect.max_idle_s)
    try:
        yield collect_batches(collector, max_idle_s=collect.max_idle_s)
    finally:
        stop_collector(collector)


@contextmanager
def taken_meanwhile(
    batches: Iterator[TensorDictBase], decisions: int
) -> Iterator[Iterator[TensorDictBase]]:
    """Take batches in a thread, up to so many ``decisions``, while the block works.

    Yields what hands over those, in their order, and then all later ones; it is for
    after the block. There an error of the thread is raised in its turn.
    """
    kept, failed = deque[TensorDictBase](), list[BaseException]()
    is_over = threading.Event()

    def take() -> None:
        number = 0
        try:
            while number < decisions and not is_over.is_set():
                # A copy: a collector may use its memory again.
                kept.append(next(batches).clone())
                number += kept[-1].numel()
        except StopIteration:
            pass
        except BaseException as error:
            failed.append(error)

    def all_batches() -> Iterator[TensorDictBase]:
        thread.join()
        while kept:
            yield kept.popleft()
        for error in failed:
            raise error
        yield from batches

    # A daemon: nobody waits for a collector that hangs when the process is to end.
    thread = threading.Thread(target=take, daemon=True, name="take batches")
    thread.start()
    try:
        yield all_batches()
    except BaseException:
        is_over.set()
        # Not for long; whoever ends the collector ends the thread.
        thread.join(_TAKE_S)
        raise
    is_over.set()


def frames_that_fit(gb: float, view_size: tuple[int, int], *, halve: bool) -> int:
    """Number of frames whose views fit into ``gb`` gigabytes.

    Examples:
        >>> frames_that_fit(0.001, (60, 80), halve=False)
        69
    """
    side = 2 if halve else 1
    height, width = view_size
    return int(gb * 1e9) // ((height // side) * (width // side) * 3)


def make_frame_buffer(
    config: PretrainConfig, world: WorldSpec
) -> TensorDictReplayBuffer:
    """The ring buffer of frames; pair sources read its storage.

    Raises `SettingsError` if it has no room for a negative pair of each environment.
    """
    collect, halve = config.collect, config.model.halve
    frames = frames_that_fit(collect.buffer_gb, world.view_size, halve=halve)
    frames = max(frames, collect.batch)
    name = "frames in collect.buffer_gb / (workers * envs)"
    length = frames // (collect.envs * collect.workers)
    config.pairs.check_room({name: length}, config.longest_m)
    storage = LazyTensorStorage(frames)
    return TensorDictReplayBuffer(storage=storage, batch_size=collect.batch)


class Rollout(NamedTuple):
    """Decisions of a policy."""

    frames: TensorDictBase  # [E, T] with the keys that were asked for
    start: TensorDictBase  # [], all entries of the first environment after its reset
    views: Tensor  # [V, H, W, 3], the first views of the first environment


@torch.no_grad()
def collect_rollout(
    env: EnvBase,
    policy: TensorDictModuleBase,
    decisions: int,
    *,
    keep: Sequence[NestedKey],
    keep_next: Sequence[NestedKey] = (),
    views: int = 0,
    progress: Callable[[int], object] | None = None,
) -> Rollout:
    """Reset E environments and play T decisions, with actions sampled as in training.

    Where an episode ends, the next one follows. Of the moment of each decision the keys
    ``keep`` are kept, of the moment after it ``keep_next``, under ``next``; missing
    ones are skipped. V ``views`` of the first environment are kept, at most T + 1.
    ``progress`` is called with E after every decision.
    """
    frames: list[TensorDictBase] = []
    seen: list[Tensor] = []
    with set_exploration_type(ExplorationType.RANDOM):
        now = env.reset()
        start = now[0].clone()
        for _ in range(decisions):
            step, following = env.step_and_maybe_reset(policy(now))
            frame = step.select(*keep, strict=False)
            if keep_next:
                frame["next"] = step["next"].select(*keep_next, strict=False)
            frames.append(frame)
            if len(seen) < views:
                seen.append(step[PIXELS][0].clone())
            now = following
            if progress is not None:
                progress(env.batch_size[0])
        if len(seen) < views:
            seen.append(step["next", PIXELS][0].clone())
    shown = torch.stack(seen) if seen else torch.empty(0)
    return Rollout(torch.stack(frames, 1), start, shown)


def collect_held_out(
    config: PretrainConfig,
    worlds: Sequence[World],
    *,
    progress: Callable[[], object] = lambda: None,
) -> list[HeldOut]:
    """Random episodes of each world that no training sees.

    The actions are uniform whatever policy the training walks with, so that the
    measurements of different runs compare. ``progress`` is called after every decision.
    """
    episodes, decisions = config.validate.episodes, config.validate.decisions
    found = []
    for number, world in enumerate(worlds):
        seed = _SEEDS_PER_RUN * config.seed + _FIRST_HELD_OUT_SEED + number
        frames = collect_walks(
            world,
            episodes,
            decisions,
            seed=seed,
            halve=config.model.halve,
            privileged=world.spec.has_truth,
            progress=progress,
        )
        found.append(HeldOut(frames, name=world.name))
    return found


def collect_walks(
    world: World,
    episodes: int,
    decisions: int,
    *,
    seed: int,
    halve: bool,
    privileged: bool = False,
    progress: Callable[[], object] = lambda: None,
) -> TensorDictBase:
    """E walks of T uniform actions, by this process; the seed decides all.

    Where the world ends an episode early, the next one follows in the same walk, and
    ``("next", "done")`` says where.
    ``progress`` is called after every decision.
    """
    env = world.make_env(
        batch_size=episodes, seed=seed, privileged=privileged, episode_length=decisions
    )
    env = add_walk_transforms(env, halve=halve)
    policy = make_walk_policy("uniform", world.spec, seed=seed)
    # One draw that is not played: held-out episodes are the same in all versions.
    policy(TensorDict(batch_size=[episodes]))
    total, name = episodes * decisions, f"held out {world.name}"
    with closing(env), tqdm(total=total, unit="decision", desc=name) as bar:

        def count(more: int) -> None:
            bar.update(more)
            progress()

        rollout = collect_rollout(
            env,
            policy,
            decisions,
            keep=HELD_OUT_KEYS,
            keep_next=[DONE],
            progress=count,
        )
    return rollout.frames
