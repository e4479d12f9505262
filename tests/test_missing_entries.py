"""What lacks an entry or a part is refused in words, by all that others build with.

An error is in words if it says what must hold and what there is.
"""

from collections.abc import Callable
from functools import partial
from inspect import isclass
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.envs.transforms import Transform
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import LossModule

from tests.graph.grid_world import RING, GridMap, make_navigator
from tests.objectives.slices import collected_slice
from toponav import data, graph, keys, modules, objectives, transforms
from toponav.ground_truth import WaypointPoses
from toponav.methods.learners.dqn import StackedQNetwork
from toponav.methods.rewards import (
    AmortisedExemplars,
    BayesianDynamics,
    ExemplarReward,
    IntrinsicCuriosity,
)
from toponav.methods.rewards.icm import CuriosityReward, GreyStack
from toponav.methods.rewards.vime import InformationGainReward
from toponav.policies import FrontierExpert, PathFollower
from toponav.worlds import Effect, Motion, WorldSpec

Thunk = Callable[[], object]


def embed(views: torch.Tensor) -> torch.Tensor:
    return views.flatten(1).float()


def compare(one: torch.Tensor, many: torch.Tensor) -> torch.Tensor:
    return 1 / (1 + (one.unsqueeze(-2) - many).abs().sum(-1))


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


def refused(act: Thunk) -> str:
    """The sentence by which something is refused; an error of another kind passes."""
    kinds = (KeyError, ValueError, TypeError, NotImplementedError)
    with pytest.raises(kinds) as refusal:
        act()
    said = str(refusal.value.args[0])
    assert "must" in said, said
    assert "got" in said, said
    return said


def classes(room: object, kind: type) -> set[str]:
    found = {name: getattr(room, name) for name in dir(room)}
    return {
        name for name, one in found.items() if isclass(one) and issubclass(one, kind)
    }


def test_every_transform_is_looked_at() -> None:
    assert classes(transforms, Transform) - READS_NOTHING <= set(TRANSFORMS)
    assert classes(objectives, LossModule) <= set(BATCHES)


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


#: Reset with nothing to pay for.
PAYING = ("Curiosity", "InformationGain", "Exemplar", "Count", "Temporal", "Intrinsic")


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


def frames(*left_out: str) -> TensorDict:
    """Two episodes of frames, but for some entries."""
    found = TensorDict(
        {
            keys.NETWORK_PIXELS: torch.zeros(2, 30, 4, 4, 3, dtype=torch.uint8),
            keys.ACTION: torch.zeros(2, 30).long(),
            "step_count": torch.arange(30).expand(2, 30),
            keys.TRAJECTORY: torch.arange(2).unsqueeze(1).expand(2, 30),
        },
        [2, 30],
    )
    return found.exclude(*left_out)


def replay_batch() -> TensorDict:
    flag = torch.zeros(2, 3, 1, dtype=torch.bool)
    now = {"pixels": torch.zeros(2, 3, 4), "action": torch.zeros(2, 3), "is_init": flag}
    later = {"pixels": torch.zeros(2, 3, 4), "reward": torch.zeros(2, 3, 1)}
    following = {**later, "done": flag, "terminated": flag}
    return TensorDict({**now, "next": following}, [2, 3])


def mined(*left_out: str, **given: object) -> data.MinedPairs:
    options = {"embed_tc": embed, "num_frames": 40, **given}
    return data.MinedPairs(frames(*left_out), **options)  # type: ignore[arg-type]


def test_the_training_data_name_what_is_missing() -> None:
    mined()()
    assert "'network_pixels'" in refused(mined("network_pixels"))
    assert "'action'" in refused(mined("action"))
    assert "step_count" in refused(mined("step_count"))
    drawn = partial(data.DrawnPairs, num_pairs=4)
    assert "'network_pixels'" in refused(drawn(frames("network_pixels")))
    split = data.SplitPairs()
    assert "'network_pixels'" in refused(lambda: split(TensorDict(batch_size=[3, 2])))
    held_out = data.HeldOut(TensorDict(batch_size=[2, 30]), name="maze1")
    assert "'network_pixels'" in refused(lambda: held_out.pixels)
    draw = partial(held_out.draw, data.LPairs(2), 4, seed=0)
    assert "'action'" in refused(draw)
    poses = WaypointPoses()
    assert "position" in refused(lambda: poses.remember(TensorDict(batch_size=[2, 3])))


def test_the_replay_names_each_entry_that_is_missing() -> None:
    make = partial(data.SliceReplay, 64, length=2, view="pixels", reward="reward")
    make().extend(replay_batch())
    for key in make().in_keys:
        said = refused(lambda key=key: make().extend(replay_batch().exclude(key)))
        assert repr(key) in said
    assert "rows" not in refused(lambda: make().sample(3))
    assert "[E, T]" in refused(lambda: make().extend(replay_batch()[0]))


def test_a_navigator_and_experts_name_each_entry_that_is_missing() -> None:
    navigator = make_navigator(GridMap(RING))
    whole = TensorDict({key: torch.zeros(1, 1) for key in navigator.in_keys}, [1])
    for key in navigator.in_keys:
        assert repr(key) in refused(partial(navigator, whole.exclude(key)))
    motion = Motion(
        cell_size=10, effects=(Effect(2.5), Effect(turn=20), Effect(turn=-20))
    )
    world = WorldSpec(view_size=(1, 1), actions=(*"alr",), motion=motion)
    for kind in (PathFollower, FrontierExpert):
        expert = kind(torch.ones(1, 3, dtype=torch.bool), world=world)
        said = refused(partial(expert, TensorDict(batch_size=[1])))
        assert "add MazeEnv(privileged=True)" in said
    network = StackedQNetwork(6, size=36, frames=4, hidden=16)
    said = refused(partial(network, TensorDict(batch_size=[1])))
    assert "add the policy's make_tensordict_primer()" in said


RULES = graph.MapRules(tc_threshold=0.9, tc_reach=0.7)
WALKING = graph.NavigatorRules(tc_reach=0.5)
KNOWN = graph.PoseMap(
    poses=torch.zeros(len(GridMap(RING).cells), 3),
    track=torch.zeros(len(GridMap(RING).cells), 2),
    effects=torch.ones(4, 3),
    places=embed,
)
#: Who is given a part that lacks what is asked of it, and what is said of it.
PARTS: dict[str, tuple[Thunk, str]] = {
    "map": (
        lambda: graph.Navigator(object(), embed, compare, embed, WALKING),
        "map must be such as a TopologicalMap, got object without num_waypoints",
    ),
    "map of over": (
        lambda: graph.Navigator.over(GridMap(RING), embed),
        "map must be such as a TopologicalMap, got GridMap without embed, compare",
    ),
    "rules of a navigator": (
        lambda: graph.Navigator(GridMap(RING), embed, compare, embed, RULES),
        "rules must be such as NavigatorRules, got MapRules without hops",
    ),
    "locomotion": (
        lambda: graph.Navigator(GridMap(RING), embed, compare, 3, WALKING),
        "locomotion must be a function or a network, got int",
    ),
    "known": (
        lambda: graph.PoseNavigator(
            GridMap(RING),
            embed,
            compare,
            WALKING,
            known=object(),
            belief=graph.BeliefRules(),
        ),
        "known must be such as a PoseMap, got object without poses, track",
    ),
    "belief": (
        lambda: graph.PoseNavigator(
            GridMap(RING), embed, compare, WALKING, known=KNOWN, belief=WALKING
        ),
        "belief must be such as BeliefRules, got NavigatorRules without spread",
    ),
    "embed of a map": (
        lambda: graph.TopologicalMap("resnet18", compare, RULES),
        "embed must be a function or a network, got str",
    ),
    "rules of a map": (
        lambda: graph.TopologicalMap(embed, compare, WALKING),
        "rules must be such as MapRules, got NavigatorRules without tc_threshold",
    ),
    "views of a map": (
        lambda: graph.TopologicalMap(embed, compare, RULES, views=[]),
        "views must be such as a ViewFile, got list without read, keep",
    ),
    "walks of a map": (
        lambda: graph.TopologicalMap(embed, compare, RULES, walks=[]),
        "walks must be such as Trajectories, got list without end, all",
    ),
    "map to consolidate": (
        lambda: graph.consolidate(
            GridMap(RING), torch.ones(4, 3), None, within=1.0, above=0.5
        ),
        "topological_map must be such as a TopologicalMap, got GridMap without",
    ),
    "network of a walk": (
        lambda: graph.WalkWaypoints(torch.zeros(3, 2), nn.Linear(2, 2)),
        "network must be such as a TCNetwork, got Linear without prepare_memory",
    ),
    "compare of a memory": (
        lambda: transforms.WaypointMemory(embed, 0.5),
        "compare must be a function or a network, got float",
    ),
    "embed of views": (
        lambda: transforms.EmbedViews("resnet18"),
        "embed must be a function or a network, got str",
    ),
    "comparator": (
        lambda: modules.TCNetwork(nn.Identity(), nn.Linear(2, 2)),
        "comparator must be such as a ConcatComparator, got Linear without prepare",
    ),
    "encoder": (
        lambda: modules.LNetwork("resnet18", nn.Identity()),
        "encoder must be a function or a network, got str",
    ),
    "rule of a sampler": (
        lambda: data.EpisodeSampler(4),
        "rule must be such as TCPairs, LPairs or Chunks, got int without draw",
    ),
    "embed of pairs": (
        lambda: mined(embed_tc="resnet18"),
        "embed_tc must be a function or a network, got str",
    ),
    "rule of pairs": (
        lambda: mined(tc_pairs=data.Chunks()),
        "tc_pairs must be such as TCPairs or LPairs, got Chunks without mine",
    ),
    "storage of pairs": (
        lambda: data.MinedPairs([], embed_tc=embed),
        "storage must be such as frames or a Storage, got list without get, ndim",
    ),
    "rule of held-out pairs": (
        lambda: data.HeldOut(frames(), name="maze1").draw(4, 10, seed=0),
        "rule must be such as TCPairs or LPairs, got int without draw",
    ),
    "networks of a reward": (
        lambda: CuriosityReward(SimpleNamespace(), 1.0),
        "icm must be a function or a network, got SimpleNamespace",
    ),
}


@pytest.mark.parametrize("case", PARTS)
def test_a_part_that_lacks_something_is_named(case: str) -> None:
    act, sentence = PARTS[case]
    assert sentence in refused(act)
