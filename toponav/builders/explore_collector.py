"""The processes that explore, and how they get their weights."""

import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.collectors import (
    BaseCollector,
    Collector,
    MultiSyncCollector,
)
from torchrl.envs import EnvBase
from torchrl.weight_update import NoWeightSyncScheme

from toponav.builders.explore_env import make_actor_critic, make_explore_env
from toponav.builders.novelty import Novelty, make_empty_novelty
from toponav.builders.process_memory import keep_freed_memory
from toponav.collectors import (
    Mailbox,
    MailboxCollector,
    PatientAsyncCollector,
    Subscription,
)
from toponav.config import ExploreConfig, TrainingError
from toponav.keys import (
    ACTION,
    ACTION_LOG_PROB,
    BORN,
    CELL,
    COUNT_REWARD,
    COVERAGE,
    COVERAGE_REWARD,
    DONE,
    EMBEDDING,
    FALSE_BIRTH,
    HEADING,
    HIDDEN,
    INTRINSIC_REWARD,
    IS_INIT,
    MEMORY_CELL,
    NETWORKS_VERSION,
    NUM_WAYPOINTS,
    PIXELS,
    POLICY_PIXELS,
    POLICY_VERSION,
    POSITION,
    PREVIOUS_ACTION,
    PREVIOUS_REWARD,
    REWARD,
    STATE_VALUE,
    TEMPORAL_DISTANCE_REWARD,
    TERMINATED,
    TRAJECTORY,
    TRUNCATED,
)

#: What is published: the explorer, and the TC-network with its threshold.
POLICY, NETWORKS = "policy", "networks"
_STATE = (PREVIOUS_ACTION, PREVIOUS_REWARD, HIDDEN, MEMORY_CELL)
_ENDS = (DONE, TERMINATED, TRUNCATED, "step_count")
_PAID = (INTRINSIC_REWARD, COUNT_REWARD, TEMPORAL_DISTANCE_REWARD, COVERAGE_REWARD)
#: What pictures of an episode need, of the first observation too.
_SEEN = (POSITION, HEADING, CELL, COVERAGE, BORN, FALSE_BIRTH)


class CollectionError(TrainingError):
    """The collecting processes stopped delivering."""


def batch_keys(config: ExploreConfig) -> list[NestedKey]:
    """What of a batch reaches the learner: views only for who learns or keeps them."""
    view = EMBEDDING if config.policy.input == "embedding" else POLICY_PIXELS
    now = [view, *_STATE, IS_INIT, ACTION, ACTION_LOG_PROB, STATE_VALUE, *_SEEN]
    now += [TRAJECTORY, "step_count"]
    if config.online.learn or config.map.grow:
        now.append(PIXELS)
    if (config.map.grow or config.locomotion.learn) and view != EMBEDDING:
        now.append(EMBEDDING)
    # A goal's reward says that the agent was put elsewhere.
    later = [view, *_STATE, *_ENDS, *_PAID, *_SEEN, NUM_WAYPOINTS]
    if config.map.grow:
        later.append(REWARD)
    under_next: list[NestedKey] = [
        ("next", key) if isinstance(key, str) else ("next", *key) for key in later
    ]
    return [*now, *under_next]


def seed_of(*parts: int) -> int:
    """A seed that differs, as good as surely, if any of the numbers does."""
    return int(np.random.SeedSequence(parts).generate_state(1)[0] >> 1)


def make_mailbox(
    policy: nn.Module, novelty: Novelty, *, versions: dict[str, int] | None = None
) -> Mailbox:
    """Where the learner leaves weights and the collecting processes fetch them."""
    return Mailbox({POLICY: policy, NETWORKS: novelty}, versions=versions)


def make_explore_collector(
    config: ExploreConfig, mailbox: Mailbox, *, decisions: int = 0
) -> BaseCollector:
    """Processes that explore with the weights in a mailbox.

    Each hands over batches ``[E, T]``, with ``collect.mode=async`` while the caller
    learns from the last one; it then is at most two batches behind the newest weights.
    With ``sync`` all wait for the caller and hand over one batch together.

    Iterate with `collect_batches`; end it in ``finally`` with `stop_collector`; never
    ask it for its state while it runs (it would drop a rollout and hang).

    Args:
        config: settings of the run.
        mailbox: see `make_mailbox`.
        decisions: those that an earlier part of the run made. Episodes begin anew
            there, others than at the run's start.

    Raises:
        EngineError: if the engine cannot start.
    """
    collect, loss = config.collect, config.loss
    asynchronous = collect.mode == "async"
    envs = collect.envs // collect.workers
    batch = envs * loss.rollout
    arguments: dict[str, Any] = {
        "create_env_kwargs": {"config": config, "envs": envs},
        "policy_factory": partial(make_actor_critic, config),
        "frames_per_batch": batch if asynchronous else batch * collect.workers,
        "total_frames": -1,
        "use_buffers": True,
        "num_threads": torch.get_num_threads(),
        "weight_sync_schemes": {POLICY: NoWeightSyncScheme()},
        "auto_register_policy_transforms": False,
        "collector_class": partial(
            make_leaf, config=config, mailbox=mailbox, decisions=decisions
        ),
    }
    make_one = [make_worker_env] * collect.workers
    if asynchronous:
        collector: BaseCollector = PatientAsyncCollector(make_one, **arguments)
    else:
        collector = MultiSyncCollector(make_one, cat_results=0, **arguments)
    return collector


def make_worker_env(
    config: ExploreConfig, envs: int, novelty: Novelty, seed: int
) -> EnvBase:
    """The environment of one collecting process."""
    return make_explore_env(
        config, novelty, envs=envs, seed=seed, stagger=config.collect.stagger
    )


def make_leaf(
    create_env_fn: Any,
    *,
    config: ExploreConfig,
    mailbox: Mailbox,
    decisions: int,
    create_env_kwargs: dict[str, Any],
    worker_idx: int,
    **kwargs: Any,
) -> MailboxCollector:
    """The collector of one process, built there, with its own copies of the networks.

    Its networks are filled before the environment looks through them for the first
    time.
    """
    # One process, one core: threads of torch would only get in each other's way.
    torch.set_num_threads(1)
    keep_freed_memory()
    seed = seed_of(config.seed, decisions, worker_idx)
    torch.manual_seed(seed)
    novelty = make_empty_novelty(config.model)
    mailbox.pull(NETWORKS, novelty)

    def refresh(collector: Collector) -> None:
        for transform in collector.env.transform:
            if hasattr(transform, "refresh"):
                transform.refresh(float(novelty.threshold))

    return MailboxCollector(
        create_env_fn,
        create_env_kwargs=create_env_kwargs | {"novelty": novelty, "seed": seed},
        worker_idx=worker_idx,
        mailbox=mailbox,
        subscriptions=[
            Subscription(POLICY, POLICY_VERSION, lambda collector: collector.policy),
            Subscription(NETWORKS, NETWORKS_VERSION, lambda _: novelty, refresh),
        ],
        keep=batch_keys(config),
        **kwargs,
    )


def collect_batches(
    collector: BaseCollector, *, max_idle_s: float
) -> Iterator[TensorDictBase]:
    """Batches of a collector, or an error of one sentence if no more come.

    A process that died is noticed within a second, one that hangs after
    ``max_idle_s``: it is ended then, since nothing else would wake the caller.

    Args:
        collector: see `make_explore_collector`.
        max_idle_s: longest time to wait for a batch.

    Raises:
        CollectionError: if a process died or hung.
    """
    batches: Iterator[TensorDictBase] = iter(collector)
    while True:
        hung = threading.Event()
        watch = threading.Timer(max_idle_s, _end_processes, (collector, hung))
        watch.daemon = True
        watch.start()
        try:
            batch = next(batches)
        except (RuntimeError, EOFError, OSError) as error:
            if hung.is_set():
                reason = f"no batch came in {max_idle_s:g} s (collect.max_idle_s)"
            else:
                reason = str(error).strip().splitlines()[0][:120]
            raise CollectionError(
                f"the collecting processes must live as long as the run, got: {reason}"
            ) from error
        finally:
            watch.cancel()
        yield batch


def _end_processes(collector: BaseCollector, hung: threading.Event) -> None:
    hung.set()
    for process in collector.procs:
        process.kill()
