"""A loss that lacks an entry or a network says so."""

from collections.abc import Callable
from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import LossModule

from tests.objectives.slices import collected_slice
from tests.refused import classes, refused
from toponav import modules, objectives


def make_actor_critic() -> tuple[nn.Module, TensorDictBase]:
    network, batch = collected_slice(rows=2, steps=3)
    return network, batch.set("label", torch.zeros(2, 3))


def make_plain() -> tuple[nn.Module, nn.Module]:
    actor = ProbabilisticActor(
        ValueOperator(MLP(3, 4), in_keys=["embedding"], out_keys=["logits"]),
        in_keys=["logits"],
        distribution_class=torch.distributions.Categorical,
    )
    return actor, ValueOperator(MLP(3, 1), in_keys=["embedding"])


def pairs() -> TensorDict:
    ends = {"anchor": torch.zeros(4, 3), "other": torch.zeros(4, 3)}
    return TensorDict({**ends, "label": torch.zeros(4), "action": torch.zeros(4)}, [4])


def loss_and_batch(kind: type) -> tuple[LossModule, TensorDictBase]:
    network, batch = make_actor_critic()
    return kind(network), batch


BATCHES: dict[str, Callable[[], tuple[LossModule, TensorDictBase]]] = {
    "A3CLoss": partial(loss_and_batch, objectives.A3CLoss),
    "TRPOLoss": partial(loss_and_batch, objectives.TRPOLoss),
    "RecurrentPPOLoss": partial(loss_and_batch, objectives.RecurrentPPOLoss),
    "TCLoss": lambda: (objectives.TCLoss(modules.ConcatComparator(3)), pairs()),
    "LLoss": lambda: (
        objectives.LLoss(modules.LocomotionHead(3, num_actions=4)),
        pairs().set("action", torch.zeros(4).long()),
    ),
}
#: What a loss computes itself where the batch lacks it.
COMPUTED = {"advantage", "value_target"}


def test_every_loss_is_looked_at() -> None:
    assert classes(objectives, LossModule) <= set(BATCHES)


@pytest.mark.parametrize("name", BATCHES)
def test_a_loss_names_each_entry_that_is_missing(name: str) -> None:
    loss, batch = BATCHES[name]()
    loss(batch.copy())
    for key in loss.in_keys:
        if key not in COMPUTED:
            said = refused(partial(loss, batch.copy().exclude(key)))
            assert f"{key if isinstance(key, str) else key[-1]}'" in said


@pytest.mark.parametrize("kind", [objectives.A3CLoss, objectives.TRPOLoss])
def test_a_loss_refuses_what_is_no_critic_or_actor(kind: type) -> None:
    actor, critic = make_plain()
    kind(actor, critic)
    assert "critic_network must" in refused(lambda: kind(actor, nn.Linear(3, 1)))
    assert "actor_network must" in refused(lambda: kind(nn.Linear(3, 1), critic))
    assert "without in_keys" in refused(lambda: kind(nn.Linear(3, 1)))
