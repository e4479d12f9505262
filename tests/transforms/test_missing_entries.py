"""A transform that lacks an entry or a part says so."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.transforms import Transform

from tests.refused import Parts, classes, compare, embed, refused
from toponav import transforms
from toponav.methods.rewards import (
    AmortisedExemplars,
    BayesianDynamics,
    ExemplarReward,
    IntrinsicCuriosity,
)
from toponav.methods.rewards.icm import CuriosityReward, GreyStack
from toponav.methods.rewards.vime import InformationGainReward

TRANSFORMS: dict[str, Callable[[], Transform]] = {
    "AreaDownsample": transforms.AreaDownsample,
    "PolicyPixels": transforms.PolicyPixels,
    "EmbedViews": partial(transforms.EmbedViews, embed),
    "NoisyTV": transforms.NoisyTV,
    "WaypointMemory": partial(transforms.WaypointMemory, embed, compare),
    "CountReward": partial(transforms.CountReward, 0.2),
    "TemporalDistanceReward": partial(transforms.TemporalDistanceReward, 0.8),
    "IntrinsicReward": transforms.IntrinsicReward,
    "PreviousAction": partial(transforms.PreviousAction, 4),
    "PreviousReward": transforms.PreviousReward,
    "GoalViews": lambda: transforms.GoalViews(
        torch.zeros(1, 2).long(), torch.zeros(1, 1, 4, 4, 3, dtype=torch.uint8)
    ),
    "Coverage": lambda: transforms.Coverage(torch.ones(2, 2, dtype=torch.bool)),
    "WaypointTruth": partial(transforms.WaypointTruth, 1.0),
    "PlacesVisited": partial(transforms.PlacesVisited, 1.0),
    "LoopClosure": partial(transforms.LoopClosure, near=1.0, far=2.0),
    "GreyStack": partial(GreyStack, (16, 16), 2),
    "CuriosityReward": lambda: CuriosityReward(IntrinsicCuriosity(4), 1.0),
    "InformationGainReward": lambda: InformationGainReward(
        BayesianDynamics((2,), 4), 1.0
    ),
    "ExemplarReward": lambda: ExemplarReward(AmortisedExemplars((2,)), 1.0),
}
#: Draws its reward and reads nothing.
READS_NOTHING = {"RandomReward"}
#: Reset with nothing to pay for.
PAYING = ("Curiosity", "InformationGain", "Exemplar", "Count", "Temporal", "Intrinsic")
PARTS: Parts = {
    "compare of a memory": (
        lambda: transforms.WaypointMemory(embed, 0.5),
        "compare must be a function or a network, got float",
    ),
    "embed of views": (
        lambda: transforms.EmbedViews("resnet18"),
        "embed must be a function or a network, got str",
    ),
    "networks of a reward": (
        lambda: CuriosityReward(SimpleNamespace(), 1.0),
        "icm must be a function or a network, got SimpleNamespace",
    ),
}


def test_every_transform_is_looked_at() -> None:
    assert classes(transforms, Transform) - READS_NOTHING <= set(TRANSFORMS)


@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_transform_without_its_entries_says_so(name: str) -> None:
    def empty() -> TensorDict:
        return TensorDict(batch_size=[2])

    steps: dict[str, Callable[[Transform], object]] = {
        "step": lambda one: one._step(empty(), empty()),
        "reset": lambda one: one._reset(empty(), empty()),
        "forward": lambda one: one(empty()),
    }
    said = {}
    for step, act in steps.items():
        transform = TRANSFORMS[name]()
        # The last action and reward, and a reward by a model, are of no first view.
        if step != "reset" or not name.startswith(("Previous", *PAYING)):
            said[step] = refused(partial(act, transform))
    read = [str(key) for key in transform.in_keys]
    assert any(key in text for key in read for text in said.values()), said


@pytest.mark.parametrize("case", PARTS)
def test_a_part_that_lacks_something_is_named(case: str) -> None:
    act, sentence = PARTS[case]
    assert sentence in refused(act)
