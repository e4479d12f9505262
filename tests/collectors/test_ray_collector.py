"""Collecting on a Ray cluster of two nodes, one of which dies."""

import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any
from unittest.mock import Mock

import psutil
import pytest
import torch
from tensordict import TensorDictBase

from tests.collectors.test_mailbox_collector import publish, require_one_version
from tests.collectors.workers import (
    ENVS,
    EchoPolicy,
    make_env,
    prepare,
    weights,
)
from tests.training.test_collecting_on_a_device import require_here
from toponav.collectors import (
    LastingRayCollector,
    MailboxError,
    RayMailbox,
)
from toponav.keys import ENV_ID, TRAJECTORY

ray = pytest.importorskip("ray", reason="Ray is not installed (extra: ray)")
pytestmark = pytest.mark.slow
cluster_utils = pytest.importorskip("ray.cluster_utils")


@pytest.fixture(scope="module")
def cluster(monkeypatch_module: pytest.MonkeyPatch) -> Iterator[Any]:
    """Two nodes with a core each; at the end none of Ray's processes is left."""
    node = {"num_cpus": 1, "object_store_memory": 10**8}
    found = cluster_utils.Cluster(initialize_head=True, head_node_args=node)
    try:
        found.add_node(**node)
        yield found
    finally:
        ray.shutdown()
        found.shutdown()
    children = psutil.Process().children(recursive=True)
    left = [one for one in children if "/ray/" in " ".join(one.cmdline())]
    assert not psutil.wait_procs(left, timeout=20)[1]


@pytest.fixture(scope="module")
def monkeypatch_module() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_worker_niceness", "0")
        yield patch


def make_mailbox() -> RayMailbox:
    return RayMailbox({"policy": weights(), "networks": weights()})


def make_collector(
    mailbox: RayMailbox, *, sync: bool = False, **prepared: Any
) -> LastingRayCollector:
    each = {"prepare": partial(prepare, mailbox=mailbox, **prepared)}
    each["auto_register_policy_transforms"] = False
    return LastingRayCollector(
        [make_env] * 2,
        policy_factory=EchoPolicy,
        frames_per_batch=ENVS * 8 * (2 if sync else 1),
        collector_kwargs=[dict(each), dict(each)],
        sync=sync,
        max_idle_s=250,
    )


@pytest.fixture
def joined(cluster: Any) -> Iterator[Any]:
    ray.init(address=cluster.address, logging_level="error", log_to_driver=False)
    yield cluster
    ray.shutdown()


def test_a_mailbox_gives_the_newest_weights(joined: Any) -> None:
    mailbox, target = make_mailbox(), weights()
    assert mailbox.names == ("policy", "networks")
    publish(mailbox, "policy")
    publish(mailbox, "policy")
    assert (mailbox.version("policy"), mailbox.version("networks")) == (2, 0)
    assert mailbox.pull("policy", target) == 2
    assert target.weight.unique().tolist() == [2.0]
    # What is published is a copy.
    torch.nn.init.constant_(target.weight, 5.0)
    assert mailbox.publish("policy", target) == 3
    torch.nn.init.constant_(target.weight, 6.0)
    mailbox.pull("policy", target)
    assert target.weight.unique().tolist() == [5.0]
    with pytest.raises(MailboxError, match="must be one of policy, networks, got 'l'"):
        mailbox.pull("l", target)
    with pytest.raises(MailboxError, match=r"must be \[200000, 1\], got \[3, 1\]"):
        mailbox.publish("policy", torch.nn.Linear(1, 3, bias=False))
    later = RayMailbox({"policy": weights()}, versions={"policy": 7})
    assert later.publish("policy", weights()) == 8


def test_weights_of_a_learner_on_a_device_come_to_processors(
    joined: Any, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = Mock(side_effect=ray.put)
    monkeypatch.setattr(ray, "put", put)
    learned = weights().to(device)
    mailbox = RayMailbox({"policy": learned})
    torch.nn.init.constant_(learned.weight, 2.0)
    assert mailbox.publish("policy", learned) == 1
    # Nothing on a device, of which other machines may have none.
    assert put.call_count == 2
    for (tensors,), _ in put.call_args_list:
        require_here(tensors)
    for module in (weights(), weights().to(device)):
        place = module.weight.device
        assert mailbox.pull("policy", module) == 1
        assert module.weight.device == place
        assert module.weight.unique().tolist() == [2.0]


def test_workers_that_wait_for_the_caller_make_one_batch(joined: Any) -> None:
    mailbox = make_mailbox()
    collector = make_collector(mailbox, sync=True)
    try:
        batches = iter(collector)
        for number in range(3):
            batch = next(batches)
            assert batch.batch_size == (2 * ENVS, 8)
            assert batch[ENV_ID][:, 0, 0].tolist() == list(range(2 * ENVS))
            assert require_one_version(batch) == (number, 0)
            publish(mailbox, "policy")
    finally:
        collector.shutdown(shutdown_ray=False)


def envs_of(batch: TensorDictBase) -> tuple[int, ...]:
    return tuple(batch[ENV_ID][:, 0, 0].tolist())


def test_a_batch_begins_when_its_workers_last_one_is_taken(joined: Any) -> None:
    mailbox, begun = make_mailbox(), {}
    collector = make_collector(mailbox)
    try:
        batches = iter(collector)
        for published in range(6):
            batch = next(batches)
            # Made with what was newest then: no batch more lies between.
            worker = envs_of(batch)
            assert require_one_version(batch) == (begun.get(worker, 0), 0)
            begun[worker] = published
            # A slow learner: meanwhile it has begun the next one.
            time.sleep(1.5)
            publish(mailbox, "policy")
        assert max(begun.values()) == 5
    finally:
        collector.shutdown(shutdown_ray=False)


def test_a_node_that_dies_costs_its_decisions_only(
    joined: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    mailbox = make_mailbox()
    collector = make_collector(mailbox)
    workers = {tuple(range(ENVS)), tuple(range(ENVS, 2 * ENVS))}
    numbers: dict[tuple[int, ...], set[int]] = {worker: set() for worker in workers}
    last = {worker: 0 for worker in workers}

    def collect(batches: Iterator[TensorDictBase]) -> tuple[int, ...]:
        batch = next(batches)
        policy, _ = require_one_version(batch)
        worker = envs_of(batch)
        # Versions never go back, and what is published arrives.
        assert last[worker] <= policy
        last[worker] = policy
        numbers[worker].update(batch[TRAJECTORY].flatten().tolist())
        publish(mailbox, "policy")
        return worker

    try:
        batches = iter(collector)
        assert {collect(batches) for _ in range(40)} == workers
        assert min(last.values()) > 5
        capsys.readouterr()
        joined.remove_node(joined.list_all_nodes()[-1], allow_graceful=False)
        said = ""
        for _ in range(2000):
            left = collect(batches)
            said += capsys.readouterr().err
            if said:
                break
        assert said.startswith(
            "a collecting process was lost with its decisions and is"
        )
        assert said.count("\n") == 1
        (lost,) = workers - {left}
        assert {collect(batches) for _ in range(20)} == {left}
        # Once there is room, it is there again, in new episodes.
        seen = last[lost]
        joined.add_node(num_cpus=1, object_store_memory=10**8)
        while collect(batches) != lost:
            pass
        assert last[lost] > seen
        first, second = numbers.values()
        assert not first & second
        # Numbered on; Ray may first have put it on the machine that had just died.
        assert max(numbers[lost]) // 2**32 in (2, 3)
    finally:
        collector.shutdown(shutdown_ray=False)


def test_what_a_worker_raises_ends_the_collection(joined: Any) -> None:
    with pytest.raises(RuntimeError, match="unexpected keyword argument 'nothing'"):
        make_collector(make_mailbox(), nothing=None)
    assert not ray.is_initialized()


def test_workers_that_cannot_live_are_given_up(
    joined: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    collector = make_collector(make_mailbox(), starts=1)
    try:
        batches = iter(collector)
        next(batches)
        for actor in collector.remote_collectors:
            ray.kill(actor)
        with pytest.raises(RuntimeError, match="none of them is left"):
            deque(batches, maxlen=0)
    finally:
        collector.shutdown(shutdown_ray=False)
    said = capsys.readouterr().err.splitlines()
    assert sum("is started again" in line for line in said) == 4
    assert sum("is given up" in line and "no more" in line for line in said) == 2
