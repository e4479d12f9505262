"""Collecting processes whose networks are on a device, built in this process.

On the stand-in device operations on tensors of two devices are refused, as on a GPU.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from tests.envs import fake_engine
from tests.exploring import explore_settings, make_policy, world_of
from tests.stand_in_device import NAME, DeviceTensor, HostWaits
from tests.test_explore import leaves
from tests.test_foreign_world import WORLD
from tests.training.test_resumed_collecting import (
    SMALL,
    batches,
    make_collector,
    make_explorer,
)
from toponav.builders import networks as networks_room
from toponav.collectors import Mailbox, MailboxCollector
from toponav.config import ExploreConfig, SettingsError
from toponav.envs import ENGINES
from toponav.keys import PLACES
from toponav.training import make_explorer as make_filled_explorer
from toponav.transforms import PlacesVisited, WaypointMemory

NOVELTY = "reward.threshold=0.5"
RIVAL = ("reward=extrinsic", "maze.goal=true", "loss.rollout=16")
#: Everything that collecting processes compute.
RUNS = [
    (NOVELTY, "collect.noisy_tv=true"),
    (NOVELTY, "policy.input=pixels", "online.learn=true"),
    (NOVELTY, "collect.mode=async", "loss=trpo", "loss.rollout=16"),
    ("reward=coverage", "loss=a3c", "loss.rollout=16"),
    ("reward=rnd",),
    ("reward=icm",),
    ("reward=vime",),
    ("reward=ex2",),
    ("reward=random",),
    (*RIVAL, "loss=dqn"),
    (*RIVAL, "loss=drqn"),
    (*RIVAL, "loss=nav_a3c"),
    (*RIVAL, "loss=nav_a3c_d2l"),
]
OTHERS = RUNS[1:-1]
#: Another world, and where its agent is, of which nothing but reports knows.
FOREIGN = (*WORLD, "world.position=[_cell.0,_cell.1]")


@pytest.fixture(autouse=True)
def registered_fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
    yield
    fake_engine.GAMES.clear()


def collector_of(config: ExploreConfig, **given: Any) -> MailboxCollector:
    return make_collector(config, Mailbox(make_explorer(config).modules()), **given)


def require_here(value: object) -> None:
    """No tensor in it is on another device than the processor."""
    for name, one in leaves(value).items():
        assert not isinstance(one, DeviceTensor), name
        assert not isinstance(one, Tensor) or one.device.type == "cpu", name


def require_equal(found: list[TensorDictBase], expected: list[TensorDictBase]) -> None:
    for one, other in zip(found, expected, strict=True):
        assert set(one.keys(True, True)) == set(other.keys(True, True))
        for key in one.keys(True, True):
            assert torch.equal(one[key], other[key]), key


def collect_there(
    device: str, collect: Callable[[str], list[TensorDictBase]]
) -> list[TensorDictBase]:
    """Batches of a device, which come to the processor, and are those of its own."""
    there = collect(device)
    for batch in there:
        require_here(batch.to_dict())
    # The numbers that a GPU draws are others.
    if device == NAME:
        require_equal(there, collect("cpu"))
    return there


# Most are slow where the stand-in device computes: two of them show the way.
@pytest.mark.parametrize(
    "overrides",
    [RUNS[0], RUNS[-1], *(pytest.param(one, marks=pytest.mark.slow) for one in OTHERS)],
)
def test_it_collects_there_as_on_the_processor(
    device: str, overrides: tuple[str, ...]
) -> None:
    def collect(place: str) -> list[TensorDictBase]:
        config = explore_settings(*SMALL, *overrides, f"collect.device={place}")
        collector = collector_of(config)
        collected = batches(collector, 3)
        assert str(collector.env.device).startswith(place)
        for one in collector.policy.parameters():
            assert str(one.device).startswith(place)
        collector.shutdown()
        return collected

    there = collect_there(device, collect)
    # Three batches of 16 decisions; first episodes are cut after 16, 32, 48 and 64.
    assert sum(int(batch["next", "done"].sum()) for batch in there) >= 3


@pytest.mark.parametrize("reward", [NOVELTY, "reward=rnd"])
def test_another_world_is_explored_there_as_on_the_processor(
    device: str, reward: str
) -> None:
    def collect(place: str) -> list[TensorDictBase]:
        words = (*FOREIGN, "policy.view_size=36", "loss.rollout=16", reward)
        config = explore_settings(*words, f"collect.device={place}")
        collector = collector_of(config)
        collected = batches(collector, 2)
        chain = collector.env.transform
        (meter,) = (one for one in chain if isinstance(one, PlacesVisited))
        for tensor in (meter.squares, *collector.policy.parameters()):
            assert str(tensor.device).startswith(place)
        collector.shutdown()
        return collected

    for batch in collect_there(device, collect):
        # A decision leads to the square beside, or nowhere: to one new place at most.
        more = batch["next", PLACES] - batch[PLACES]
        assert more.unique().tolist() == [0, 1]


def test_weights_come_there_from_a_learner_there(device: str) -> None:
    config = explore_settings(*SMALL, NOVELTY, f"device={device}")
    explorer = make_explorer(config)
    explorer.policy.to(device)
    mailbox = Mailbox(explorer.modules())
    collector = make_collector(config, mailbox)
    batches(collector, 1)
    with torch.no_grad():
        explorer.policy.critic.bias += 1.0
    mailbox.publish("policy", explorer.policy)
    (batch,) = batches(collector, 1)
    collector.shutdown()
    assert batch["version", "policy"].unique().tolist() == [1]
    bias = collector.policy.critic.bias
    assert str(bias.device).startswith(device)
    assert bias.item() == pytest.approx(explorer.policy.critic.bias.item())


@pytest.mark.slow
@pytest.mark.parametrize("other", [True, False])
@pytest.mark.parametrize("overrides", [RUNS[0], RUNS[1], RUNS[4], RUNS[12]])
def test_episodes_go_on_there_and_elsewhere(
    device: str, overrides: tuple[str, ...], other: bool
) -> None:
    config = explore_settings(*SMALL, *overrides, f"collect.device={device}")
    explorer = make_explorer(config)
    mailbox = Mailbox(explorer.modules())
    whole = make_collector(config, mailbox)
    batches(whole, 2)
    state = whole.running_episodes()
    require_here(state)
    expected = batches(whole, 2)
    whole.shutdown()
    place = "cpu" if other else device
    config = explore_settings(*SMALL, *overrides, f"collect.device={place}")
    resumed = make_collector(config, mailbox, decisions=1, episodes=[state])
    found = batches(resumed, 2)
    resumed.shutdown()
    # A GPU draws other numbers than the processor.
    if device == NAME or not other:
        require_equal(found, expected)


@pytest.mark.slow
def test_the_host_waits_for_three_things_in_each_decision(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if device != NAME:
        pytest.skip("only the stand-in device counts")
    monkeypatch.setattr(WaypointMemory, "_is_free", lambda memory, device: False)

    def waits(decisions: int) -> Counter[str]:
        # No episode ends meanwhile: those that begin are numbered one by one.
        words = (f"loss.rollout={decisions}", "collect.stagger=false")
        words += ("maze.episode_length=200",)
        config = explore_settings(*SMALL, NOVELTY, *words, f"collect.device={NAME}")
        collector = collector_of(config)
        # Buffers have grown, and the batch is made, once there was one.
        batches(collector, 1)
        with HostWaits() as found:
            collector.rollout()
        collector.shutdown()
        return Counter(found.names)

    more = waits(32)
    more.subtract(waits(16))
    # In 16 decisions: actions for the engines (a list), and whether an episode ended,
    # which TorchRL asks three times (a number each: twice for the reset, once for the
    # number of the trajectory). Once in 16 the memory is checked (three numbers) and
    # its waypoints counted (a list), as spurious ones are, at most thrice.
    assert more["aten._local_scalar_dense"] == 3 * 16 + 3
    assert 16 + 1 <= more["tolist"] <= 16 + 4
    del more["aten._local_scalar_dense"], more["tolist"]
    assert not +more


@pytest.mark.parametrize("encoder", ["resnet18", "small"])
@pytest.mark.parametrize("fast", [True, False])
def test_networks_are_in_bfloat16_where_their_device_is_fast_so(
    device: str, fast: bool, encoder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def has_fast_bf16(where: torch.device) -> bool:
        asked.append(str(where))
        return fast

    monkeypatch.setattr(networks_room, "has_fast_bf16", has_fast_bf16)
    config = explore_settings(*SMALL, NOVELTY, f"model.encoder={encoder}")
    explorer = make_filled_explorer(
        config, world_of(config), ["networks"], lambda name, module: 0, device=device
    )
    assert explorer.novelty is not None
    (weight, *_) = explorer.novelty.tc.parameters()
    assert str(weight.device).startswith(device)
    in_bf16 = fast and encoder == "resnet18"
    assert weight.dtype == (torch.bfloat16 if in_bf16 else torch.float32)
    assert all(one.startswith(device) for one in asked)
    assert str(next(make_policy(config).parameters()).dtype) == "torch.float32"


def test_they_follow_the_learner_unless_told_otherwise() -> None:
    def place(*words: str) -> str:
        return explore_settings(*words).collect_device

    assert place() == "cpu"
    assert place("device=cuda:1") == "cuda:1"
    assert place("device=cuda", "collect.device=cpu") == "cpu"
    assert place("collect.device=auto") == "auto"
    assert place("device=cuda", "collect.backend=ray") == "cpu"
    assert place("scale=paper") == "auto"


def test_a_gpu_of_a_cluster_is_refused() -> None:
    rule = "collect.device must be null or cpu with collect.backend=ray, got 'cuda'"
    with pytest.raises(SettingsError, match=rule):
        explore_settings("collect.device=cuda", "collect.backend=ray")
