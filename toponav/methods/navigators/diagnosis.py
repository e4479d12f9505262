"""Diagnosis: the chosen navigator, told the truth about parts of its task.

What it gains in goals by a truth is what the part that the truth replaces costs. These
policies read privileged keys and are no agents.
"""

from collections.abc import Callable, Collection
from typing import Literal

from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from toponav.builders import AgentKnowledge, GroundTruth
from toponav.config import NavigatorConfig
from toponav.keys import TRUE_PLACE
from toponav.methods.navigators.truths import TruePlace, TrueSteering, true_edges

#: What a navigator may be given: the edges of its map, with their costs; the waypoint
#: where it is; the way to its next target.
Part = Literal["map", "place", "controller"]
#: By the name that ``evaluate.policies`` takes.
DIAGNOSES: dict[str, tuple[Part, ...]] = {
    "perfect_controller": ("controller",),
    "perfect_place": ("place",),
    "perfect_map": ("map",),
    "perfect_controller_place": ("controller", "place"),
    "perfect_controller_map": ("controller", "map"),
    "perfect_place_map": ("place", "map"),
}


def make_diagnosis(
    config: NavigatorConfig,
    given: Collection[Part],
    *,
    make: Callable[..., TensorDictModuleBase],
    knowledge: AgentKnowledge,
    truth: GroundTruth,
    seed: int = 0,
) -> TensorDictModuleBase:
    """The navigator that ``make`` makes, ``given`` parts of the truth and no more."""
    world = knowledge.world
    navigator = make(
        config,
        knowledge=knowledge,
        edges=true_edges(truth, world=world) if "map" in given else None,
        place_key=TRUE_PLACE if "place" in given else None,
        seed=seed,
    )
    before = [TruePlace(truth, world=world)] if "place" in given else []
    # The navigator goes by the actions that are done, not by those that it drew.
    tell = getattr(navigator, "took", None)
    steering = TrueSteering(truth, world=world, tell=tell)
    after = [steering] if "controller" in given else []
    return TensorDictSequential(*before, navigator, *after)
