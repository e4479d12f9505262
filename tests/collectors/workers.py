"""What the tests' worker processes build: they must find it by import."""

import time
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, EnvBase, StepCounter, TransformedEnv
from torchrl.envs.transforms import Transform
from torchrl.weight_update import NoWeightSyncScheme

from tests.fakes import FakeMaze
from toponav.collectors import (
    Mailbox,
    MailboxCollector,
    PatientAsyncCollector,
    RayMailbox,
    Subscription,
)
from toponav.keys import NETWORKS_VERSION, PIXELS, TRAJECTORY

#: Weights long enough that a copy takes a while.
SIZE = 200_000
ENVS = 3


def weights() -> nn.Module:
    module = nn.Linear(1, SIZE, bias=False)
    nn.init.zeros_(module.weight)
    return module


def first_and_last(module: nn.Module) -> Tensor:
    """The two ends of the weights: they differ in a copy that is torn."""
    weight = module.state_dict()["weight"]
    return torch.stack([weight[0, 0], weight[-1, 0]])


class EchoPolicy(TensorDictModuleBase):
    """Goes forward, and says which weights it has."""

    in_keys = [PIXELS]
    out_keys = ["action", "policy_says"]

    def __init__(self) -> None:
        super().__init__()
        self.weights = weights()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        says = first_and_last(self.weights).expand(*shape, 2).clone()
        # Time for a publication to come in between.
        time.sleep(1e-3)
        tensordict.set("action", torch.zeros(shape, dtype=torch.int64))
        return tensordict.set("policy_says", says)


class EchoTransform(Transform):
    """Says which weights it has, and how often it was notified of new ones."""

    def __init__(self) -> None:
        super().__init__(in_keys=["previous_reward"], out_keys=["previous_reward"])
        self.weights = weights()
        self.refreshed = 0

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        says = torch.cat([first_and_last(self.weights), torch.tensor([self.refreshed])])
        shape = next_tensordict.batch_size
        next_tensordict.set("networks_say", says.float().expand(*shape, 3).clone())
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        shape = tensordict_reset.batch_size
        return tensordict_reset.set("networks_say", torch.zeros(*shape, 3))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["networks_say"] = Unbounded((*observation_spec.shape, 3))
        return observation_spec

    def refresh(self) -> None:
        self.refreshed += 1


def make_env(*transforms: Transform) -> EnvBase:
    env = FakeMaze(batch_size=(ENVS,), max_decisions=10)
    return TransformedEnv(env, Compose(EchoTransform(), *transforms))


def make_counting_env() -> EnvBase:
    env = FakeMaze(batch_size=(ENVS,), max_decisions=10_000)
    return TransformedEnv(env, StepCounter())


def find_networks(collector: Collector) -> nn.Module:
    return collector.env.transform[0].weights


def find_policy(collector: Collector) -> nn.Module:
    return collector.policy.weights


def refresh(collector: Collector) -> None:
    collector.env.transform[0].refresh()


SUBSCRIPTIONS = (
    Subscription("policy", ("version", "policy"), find_policy),
    Subscription("networks", NETWORKS_VERSION, find_networks, refresh),
)


KEPT = ["action", "policy_says", ("next", "networks_say"), TRAJECTORY]


def make_workers(mailbox: Mailbox, num_workers: int) -> PatientAsyncCollector:
    return PatientAsyncCollector(
        [make_env] * num_workers,
        policy_factory=EchoPolicy,
        frames_per_batch=ENVS * 8,
        total_frames=-1,
        weight_sync_schemes={"policy": NoWeightSyncScheme()},
        auto_register_policy_transforms=False,
        collector_class=partial(
            MailboxCollector,
            mailbox=mailbox,
            subscriptions=SUBSCRIPTIONS,
            keep=KEPT[:3],
        ),
    )


def prepare(
    worker_idx: int, start: int, *, mailbox: RayMailbox, starts: int = 99
) -> dict[str, Any]:
    """What a worker's collector is made of, anywhere in a cluster."""
    if start >= starts:
        raise ValueError("there are no more starts")
    return {"mailbox": mailbox, "subscriptions": SUBSCRIPTIONS, "keep": KEPT}
