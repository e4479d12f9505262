"""Whether this machine has room for a run, looked at before anything starts.

All sizes are what a run needs at least: what it learns and draws comes on top.
"""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from torch import nn

from toponav.builders import (
    NETWORKS_FILE,
    World,
    make_device,
    make_networks,
    pretraining_folder,
)
from toponav.config import ExploreConfig, PretrainConfig, require
from toponav.envs import load_engine
from toponav.methods import LEARNERS, REWARDS
from toponav.runs import require_memory, require_room, require_shared_memory

_MB, _FLOAT, _HALF = 1e-6, 4, 2
# A socket's path has at most 103 bytes (macOS; 107 on Linux), of which Python takes 32:
# /pymp-xxxxxxxx/listener-xxxxxxxx. Beyond, views of a pre-training never arrive.
_LONGEST_TMPDIR = 71
#: MB of tables, pictures, logs and a video.
_SMALL_MB = 4.0
# Of each process that collects, since each of some fifty entries has pages of its own.
_PAGES = 200_000
# Rewards, flags, poses and counts of a decision.
_ENTRIES = 1_000
# A checkpoint has each weight and two numbers of its optimiser, and is written beside
# the former one.
_CHECKPOINTS = 2 * 3


def require_explore_room(settings: ExploreConfig, world: World, folder: Path) -> None:
    """Refuse an exploration for which this machine has no room, or not the device.

    Raises:
        SettingsError: that names the setting, and the folder if there is one.
    """
    make_device(settings.device)
    make_device(settings.collect_device, "collect.device")
    needed = REWARDS[settings.reward.name].needs_networks
    has_networks = needed or settings.pretrained is not None
    settings = settings.resolved(settings.model if has_networks else None)
    learner = LEARNERS[settings.loss.name]
    # Before a policy is made, which may be of what such a sense measures.
    learner.require_senses(settings, world)
    policy = weight_bytes(learner.make_policy(settings, world))
    fresh = make_networks(settings.model, world.spec) if has_networks else None
    files: float = (_CHECKPOINTS + 1) * policy
    if fresh is not None and settings.pretrained is None:
        networks = weight_bytes(fresh.modules)
        files += networks + 2 * _walks_bytes(settings)
        kept = pretraining_folder(settings)
        if not settings.resume and not (kept / NETWORKS_FILE).is_file():
            megabytes = _SMALL_MB + (_CHECKPOINTS + 1) * networks * _MB
            require_room(kept, "pretraining.folder", megabytes)
    if fresh is not None and settings.locomotion.learn is not False:
        # All of it is taken at the first batch.
        walks = settings.locomotion.memory * _HALF * settings.model.embedding_dim
        require_memory(walks * _MB, "locomotion.memory")
    where = "resume" if settings.resume else "hydra.run.dir"
    require_room(folder, where, _SMALL_MB + files * _MB)
    if settings.collect.backend == "local":
        # Processes fetch the policy and, where views are embedded, the TC-network.
        shared = policy + (0 if fresh is None else weight_bytes(fresh.tc))
        shared += _batch_bytes(settings, world, has_networks=has_networks)
        shared += settings.collect.envs * _engine_bytes(settings)
        require_shared_memory(shared * _MB, "collect.envs")


def require_pretrain_room(
    settings: PretrainConfig, worlds: Sequence[World], networks: nn.Module, folder: Path
) -> None:
    """Refuse a pre-training whose files or shared memory have no room.

    Raises:
        SettingsError: that names the folder and its setting.
    """
    where = "resume" if settings.resume else "hydra.run.dir"
    weights = (_CHECKPOINTS + 1) * weight_bytes(networks)
    require_room(folder, where, _SMALL_MB + weights * _MB)
    if settings.train.updates:
        temporary = tempfile.gettempdir()
        rule = f"TMPDIR must be at most {_LONGEST_TMPDIR} bytes long, since processes "
        rule += "talk through sockets in it"
        require(len(os.fsencode(temporary)) <= _LONGEST_TMPDIR, rule, f"'{temporary}'")
        collect = settings.collect
        processes = max(collect.workers, len(worlds))
        shared = collect.batch * _view_bytes(worlds[0], halve=settings.model.halve)
        shared += collect.envs * _engine_bytes(settings)
        require_shared_memory(processes * shared * _MB, "collect.batch")


def weight_bytes(module: nn.Module) -> int:
    """Memory of a module's parameters and buffers.

    Examples:
        >>> weight_bytes(nn.Linear(2, 3))
        36
    """
    return sum(one.nbytes for one in module.state_dict().values())


def _walks_bytes(settings: ExploreConfig) -> float:
    """What the walks take that a map by poses is made of, in a checkpoint."""
    by_poses = settings.maps_by_poses(effects_known=settings.world.group == "maze")
    if not (settings.map.grow and by_poses) or settings.collect.minutes:
        return 0
    collect, fed = settings.collect, settings.map.envs
    share = min(fed or collect.envs, collect.envs) / collect.envs
    return share * collect.decisions * _HALF * settings.model.embedding_dim


def _batch_bytes(settings: ExploreConfig, world: World, *, has_networks: bool) -> int:
    """Decisions of one rollout of all environments, as processes hand them over."""
    policy = settings.policy
    seen = 3 * policy.view_size**2
    if policy.input == "embedding":
        seen = _FLOAT * settings.model.embedding_dim
    # Before and after a decision, and the state of the LSTM.
    decision = _ENTRIES + 2 * seen + 2 * _FLOAT * policy.hidden * policy.layers
    if has_networks and settings.map.grow:
        decision += _view_bytes(world, halve=settings.model.halve)
    collect = settings.collect
    return collect.workers * _PAGES + collect.envs * settings.loss.rollout * decision


def _view_bytes(world: World, *, halve: bool) -> int:
    height, width = world.spec.view_size
    side = 2 if halve else 1
    return (height // side) * (width // side) * 3


def _engine_bytes(settings: ExploreConfig | PretrainConfig) -> int:
    if settings.world.name != "maze":
        return 0
    return load_engine(settings.engine).shared_bytes
