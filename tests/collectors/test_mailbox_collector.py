from collections import deque

import psutil
import pytest
import torch
from tensordict import TensorDictBase

from tests.collectors.workers import (
    ENVS,
    SUBSCRIPTIONS,
    EchoPolicy,
    make_env,
    make_workers,
    weights,
)
from toponav.collectors import Mailbox, MailboxCollector
from toponav.keys import ENV_ID, NETWORKS_VERSION


def publish(mailbox: Mailbox, name: str) -> None:
    """Publish weights that are all equal to their version."""
    module = weights()
    torch.nn.init.constant_(module.weight, float(mailbox.version(name) + 1))
    mailbox.publish(name, module)


def make_mailbox() -> Mailbox:
    return Mailbox({"policy": weights(), "networks": weights()})


def require_one_version(batch: TensorDictBase) -> tuple[int, int]:
    """The versions of the policy and of the networks that made every decision."""
    (policy,) = batch["version", "policy"].unique().tolist()
    (networks,) = batch[NETWORKS_VERSION].unique().tolist()
    assert batch["policy_says"].unique().tolist() == [policy]
    assert batch["next", "networks_say"][..., :2].unique().tolist() == [networks]
    return policy, networks


def make_collector(mailbox: Mailbox, **kwargs: object) -> MailboxCollector:
    return MailboxCollector(
        make_env,
        EchoPolicy(),
        mailbox=mailbox,
        subscriptions=SUBSCRIPTIONS,
        frames_per_batch=ENVS * 8,
        auto_register_policy_transforms=False,
        **kwargs,
    )


@pytest.mark.parametrize("use_buffers", [True, False])
def test_a_batch_says_which_weights_made_it(use_buffers: bool) -> None:
    mailbox = make_mailbox()
    collector = make_collector(mailbox, use_buffers=use_buffers)
    try:
        for number, batch in enumerate(collector):
            assert require_one_version(batch) == (number, number // 2)
            assert batch.batch_size == (ENVS, 8)
            if number == 4:
                break
            publish(mailbox, "policy")
            if number % 2:
                publish(mailbox, "networks")
    finally:
        collector.shutdown()


def test_embeddings_are_computed_again_only_when_networks_changed() -> None:
    mailbox = make_mailbox()
    collector = make_collector(mailbox)
    entries = []
    try:
        for batch in collector:
            entries += batch["next", "networks_say"][..., 2].unique().tolist()
            if len(entries) == 4:
                break
            publish(mailbox, "policy")
            if len(entries) in (1, 3):
                publish(mailbox, "networks")
    finally:
        collector.shutdown()
    assert entries == [0, 1, 1, 2]


def test_environments_are_numbered_over_all_workers() -> None:
    collector = make_collector(make_mailbox(), worker_idx=2)
    try:
        batch = next(iter(collector))
    finally:
        collector.shutdown()
    expected = torch.arange(6, 9).reshape(3, 1, 1).expand(3, 8, 1)
    assert torch.equal(batch[ENV_ID], expected)


def test_only_what_is_kept_is_handed_over() -> None:
    collector = make_collector(
        make_mailbox(), keep=["action", "policy_says", ("next", "networks_say")]
    )
    try:
        batch = next(iter(collector))
    finally:
        collector.shutdown()
    kept = {"action", "policy_says", ("next", "networks_say")}
    assert set(batch.keys(True, True)) == kept | {
        ENV_ID,
        ("version", "policy"),
        NETWORKS_VERSION,
    }


@pytest.mark.slow
def test_two_workers_make_each_batch_with_one_version() -> None:
    mailbox = make_mailbox()
    collector = make_workers(mailbox, 2)
    policies, networks, envs = set(), set(), set()
    try:
        for number, batch in enumerate(collector):
            policy, network = require_one_version(batch)
            policies.add(policy)
            networks.add(network)
            envs |= set(batch[ENV_ID].flatten().tolist())
            if number == 60:
                break
            publish(mailbox, "policy")
            if number % 5 == 0:
                publish(mailbox, "networks")
    finally:
        collector.shutdown()
    assert len(policies) > 20
    assert len(networks) > 5
    assert envs == set(range(2 * ENVS))


@pytest.mark.slow
def test_a_worker_that_dies_ends_the_collection() -> None:
    collector = make_workers(make_mailbox(), 1)
    try:
        frames = iter(collector)
        next(frames)
        (worker,) = collector.procs
        psutil.Process(worker.pid).kill()
        with pytest.raises(RuntimeError, match="At least one process failed"):
            deque(frames, maxlen=0)
    finally:
        collector.shutdown(raise_on_error=False)
