"""Mazes in other processes: TorchRL's parallel environments and collectors."""

from functools import partial

import pytest
import torch
from torchrl.collectors import Collector, MultiAsyncCollector, MultiSyncCollector
from torchrl.envs import EnvBase, ParallelEnv, StepCounter, TransformedEnv
from torchrl.envs.utils import RandomPolicy, check_env_specs

from tests.envs.layouts import GATE
from toponav.envs import MazeEnv


def make(batch_size: int | None = None, seed: int = 0) -> EnvBase:
    env = MazeEnv(
        GATE, batch_size=batch_size, episode_length=6, privileged=True, seed=seed
    )
    return TransformedEnv(env, StepCounter())


@pytest.mark.slow
def test_specs_hold_in_spawned_workers() -> None:
    env = ParallelEnv(2, partial(make, 2), mp_start_method="spawn")
    try:
        check_env_specs(env, break_when_any_done="both")
    finally:
        env.close()


def test_a_collector_cuts_episodes_at_the_clock() -> None:
    collector = Collector(make, RandomPolicy(make_spec()), **frames(20, 40))
    try:
        batches = [batch.clone() for batch in collector]
    finally:
        collector.shutdown()
    check(torch.cat(batches))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MultiSyncCollector, MultiAsyncCollector])
def test_collectors_of_workers_deliver_episodes(kind: type) -> None:
    collector = kind(
        [partial(make, 2), partial(make, 2, 1)],
        RandomPolicy(make_spec(2)),
        **frames(48, 144),
        **({"cat_results": "stack"} if kind is MultiSyncCollector else {}),
    )
    try:
        batches = [batch.clone() for batch in collector]
    finally:
        collector.shutdown()
    assert sum(batch.numel() for batch in batches) >= 144
    for batch in batches:
        for row in batch.reshape(-1, batch.shape[-1]):
            check(row)


def make_spec(batch_size: int | None = None):
    env = make(batch_size)
    spec = env.full_action_spec["action"]
    env.close()
    return spec


def frames(per_batch: int, total: int) -> dict[str, int]:
    return {"frames_per_batch": per_batch, "total_frames": total}


def check(row) -> None:
    """Steps of one maze in a row: counted from 1 to 6, then from 1 again."""
    count = row["next", "step_count"].flatten().tolist()
    assert count == [1 + (count[0] - 1 + i) % 6 for i in range(len(count))]
    done = row["next", "done"].flatten().tolist()
    assert done == [number == 6 for number in count]
    # What a step saw is what the next one starts from, except over a reset.
    same = (row["next", "pixels"][:-1] == row["pixels"][1:]).flatten(1).all(-1)
    assert all(same[i] or done[i] for i in range(len(same)))
