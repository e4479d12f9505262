"""Specs, state, weights and privileges of the whole chain of novelty."""

import copy
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.transforms import Transform

from tests.checks import check_parallel, check_transform
from tests.fakes import FakeMaze
from tests.transforms.colour_world import compare, embed, flags, reset, shade, step
from toponav import keys
from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    PolicyPixels,
    PreviousAction,
    PreviousReward,
    TemporalDistanceReward,
    WaypointMemory,
    WaypointTruth,
)

OWN_KEYS = [
    ("novelty", name)
    for name in ("embedding", "place", "like", "new", "is_new_waypoint")
]
OWN_KEYS += ["visits_of_mine", ("novelty", "how_many")]


def first_pixel(views):
    return views[..., 0, 0, :].float() / 255


def closeness(one, many):
    return (-4 * (one.unsqueeze(-2) - many).norm(dim=-1)).exp()


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def make_chain(**arguments):
    settings = {"threshold": 0.8, "capacity": 5} | arguments
    return Compose(
        WaypointMemory(first_pixel, closeness, **settings),
        CountReward(0.2),
        TemporalDistanceReward(0.8),
        IntrinsicReward(),
        PolicyPixels((6, 8)),
        PreviousAction(6),
        PreviousReward(),
        WaypointTruth(96),
    )


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, partial(make_chain, keep_images=True))


def test_specs_hold_for_keys_of_ones_own():
    check_transform(
        make_maze, partial(WaypointMemory, first_pixel, closeness, out_keys=OWN_KEYS)
    )


@pytest.mark.slow
def test_specs_hold_in_processes():
    check_parallel(make_maze, make_chain)


class Shared(nn.Module):
    """A network whose embedding can be changed, as by training."""

    def __init__(self):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(1))

    def embed(self, views):
        return embed(views) * self.scale


def test_the_networks_are_nobodys_property():
    network = Shared()
    memory = WaypointMemory(network.embed, nn.Identity())
    assert list(memory.parameters()) == []
    reset(memory, shade(0.5))
    assert not any("scale" in name for name in memory.state_dict())


def test_nothing_carries_a_gradient():
    network = Shared()
    memory = WaypointMemory(network.embed, compare)
    reset(memory, shade(0.0))
    data = step(memory, shade(0.5))
    assert not any(value.requires_grad for value in data.values())


def make_refreshable(network):
    return WaypointMemory(network.embed, compare, threshold=0.8, keep_images=True)


def test_refresh_embeds_every_waypoint_again():
    network = Shared()
    memory = make_refreshable(network)
    reset(memory, shade(0.0, 1.0))
    for now in ((0.5, 0.5), (0.5, 0.0), (0.5, 0.0)):
        step(memory, shade(*now))
    with torch.no_grad():
        network.scale.fill_(0.5)
    memory.refresh(chunk=2)
    # Waypoints 0, 0.5 and 1, 0.5, 0 are now at half of that; visits go on.
    assert flags(step(memory, shade(0.5, 1.0)), 0) == (1, 1.0, False, False, 4, 2)
    assert flags(step(memory, shade(0.0, 1.0)), 1) == (0, 1.0, False, False, 3, 3)


def test_without_refresh_the_memory_is_stale():
    # The test above would pass on any memory if this one did not hold.
    network = Shared()
    memory = make_refreshable(network)
    reset(memory, shade(1.0))
    with torch.no_grad():
        network.scale.fill_(0.5)
    assert step(memory, shade(1.0))[keys.NOVEL].item()


def test_refresh_takes_the_new_threshold():
    memory = make_refreshable(Shared())
    reset(memory, shade(0.0))
    assert not step(memory, shade(0.125))[keys.NOVEL].item()
    memory.refresh(threshold=0.9)
    assert memory.threshold == 0.9
    assert step(memory, shade(0.125))[keys.NOVEL].item()
    with pytest.raises(ValueError, match=r"threshold must be in \[0, 1\), got 1.5"):
        memory.refresh(threshold=1.5)


def test_refresh_needs_the_images():
    memory = WaypointMemory(embed, compare)
    with pytest.raises(ValueError, match="keep_images must be True to refresh"):
        memory.refresh()


def test_refresh_before_the_first_reset_only_sets_the_threshold():
    memory = make_refreshable(Shared())
    memory.refresh(threshold=0.6)
    assert memory.threshold == 0.6


def test_images_are_kept_as_they_were_seen():
    torch.manual_seed(0)
    chain = make_chain(keep_images=True, capacity=20, threshold=0.97)
    env = TransformedEnv(make_maze([2]), chain)
    data = env.rollout(5, break_when_any_done=False)
    images = env.transform[0].slots.images
    assert images.dtype is torch.uint8
    new_waypoints = data["next", keys.IS_NEW_WAYPOINT].squeeze(-1).nonzero().tolist()
    assert len(new_waypoints) > 4
    for row, decision in new_waypoints:
        now = data["next"][row, decision]
        assert (images[row, now[keys.WAYPOINT].item()] == now[keys.PIXELS]).all()


def test_a_resumed_episode_goes_on_the_same():
    arguments = {
        "threshold": 0.7,
        "capacity": 4,
        "persistence": 2,
        "min_gap": 2,
        "count_on": "entry",
        "keep_images": True,
    }
    generator = torch.Generator().manual_seed(0)
    way = torch.rand(60, 3, generator=generator)
    saved = WaypointMemory(embed, compare, **arguments)
    reset(saved, shade(*way[0]))
    for now in way[1:30]:
        step(saved, shade(*now))
    saved.refresh(threshold=0.8)
    loaded = WaypointMemory(embed, compare, **arguments)
    loaded.load_state_dict(copy.deepcopy(saved.state_dict()))
    assert loaded.threshold == 0.8
    for now in way[30:]:
        one, other = step(saved, shade(*now)), step(loaded, shade(*now))
        assert (one == other).all()
    saved.refresh()
    loaded.refresh()
    assert torch.equal(saved.slots.memory, loaded.slots.memory)


def test_a_loaded_state_compares_all_that_is_known():
    saved, loaded = (WaypointMemory(embed, compare, threshold=0.9) for _ in range(2))
    reset(saved, shade(0.0))
    for grey in (0.25, 0.5, 0.75, 1.0):
        step(saved, shade(grey))
    loaded.load_state_dict(saved.state_dict())
    assert step(loaded, shade(1.0))[keys.WAYPOINT].item() == 4


def test_clones_have_an_episode_of_their_own():
    memory = WaypointMemory(embed, compare)
    reset(memory, shade(0.0))
    other = memory.clone()
    step(other, shade(1.0))
    assert flags(step(memory, shade(0.0))) == (0, 1.0, False, False, 2, 1)


def test_slots_grow_and_keep_what_they_hold():
    memory = WaypointMemory(embed, compare, threshold=0.99, keep_images=True)
    reset(memory, shade(0.0))
    for number in range(1, 41):
        assert step(memory, shade(number / 40))[keys.IS_NEW_WAYPOINT].item()
    for number in range(41):
        assert step(memory, shade(number / 40))[keys.WAYPOINT].item() == number
        assert memory.slots.images[0, number].item() == pytest.approx(number / 40)


class Scramble(Transform):
    """Fills every privileged entry with noise, ahead of the chain."""

    def _call(self, next_tensordict):
        truth = next_tensordict.get(keys.PRIVILEGED)
        for key, value in truth.items(True, True):
            noise = (
                torch.randint_like(value, 2) if value.dtype != torch.bool else ~value
            )
            truth.set(key, noise)
        return next_tensordict

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)


def test_what_an_agent_sees_does_not_depend_on_the_truth():
    def rollout(*first: Transform) -> TensorDict:
        generator = torch.Generator().manual_seed(0)

        def act(views):
            return torch.randint(6, views.shape[:1], generator=generator)

        policy = TensorDictModule(act, [keys.PIXELS], [keys.ACTION])
        env = TransformedEnv(make_maze([3]), Compose(*first, *make_chain()))
        return env.rollout(20, policy, break_when_any_done=False)["next"]

    honest, scrambled = rollout(), rollout(Scramble())
    assert (honest[keys.POSITION] != scrambled[keys.POSITION]).any()
    agent_side = honest.exclude(keys.PRIVILEGED)
    assert len(list(agent_side.keys(True, True))) > 15
    for key in agent_side.keys(True, True):
        assert torch.equal(honest[key], scrambled[key]), key


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (
            partial(WaypointMemory, embed, compare, in_keys=["rgb"]),
            "'rgb' must be an observation of the env",
        ),
        (
            partial(WaypointMemory, embed, compare, in_keys=[keys.CELL]),
            r"must be images, got \[2\]",
        ),
        (
            partial(WaypointMemory, lambda views: views, compare),
            r"embed must return \[N, D\], got \[1, 12, 16, 3\]",
        ),
        (
            partial(WaypointMemory, first_pixel, lambda one, many: one.sum(-1)),
            r"compare must return \[N, M\], got \[1\] for N = 1 and M = 1",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_the_specs(memory, message):
    with pytest.raises(ValueError, match=message):
        TransformedEnv(FakeMaze(), memory()).observation_spec  # noqa: B018


def make_far_memory(*callables, **arguments):
    """A memory that works as on a device that must be waited for."""
    memory = WaypointMemory(*callables, **arguments)
    memory._is_free = lambda device: False
    return memory


def check_far(far, to_device, **arguments):
    """Compare with a memory on the CPU, decision by decision, through two resets."""
    way = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    arguments |= {"threshold": 0.95, "keep_images": True}
    near = WaypointMemory(embed, compare, **arguments)
    far = far(embed, compare, **arguments)
    new_waypoints = 0
    for number, now in enumerate(way):
        act = reset if number % 25 == 0 else step
        one, other = act(near, shade(*now)), act(far, to_device(shade(*now)))
        torch.testing.assert_close(one, other.cpu())
        new_waypoints += int(one[keys.IS_NEW_WAYPOINT].sum())
    assert new_waypoints > 15
    far.refresh()
    live = near.slots.live
    for name in ("memory", "images"):
        one, other = (getattr(memory.slots, name).cpu() for memory in (near, far))
        assert torch.equal(
            one[:, : live.shape[1]][live], other[:, : live.shape[1]][live]
        )


CAPACITIES = [{"capacity": 100}, {"capacity": 6}]


@pytest.mark.parametrize("arguments", CAPACITIES)
def test_it_does_the_same_without_looking_at_the_numbers(arguments):
    check_far(make_far_memory, lambda data: data, **arguments)


def test_broken_embeddings_are_found_soon_without_looking_each_time():
    memory = make_far_memory(embed, compare)
    reset(memory, shade(0.0))
    broken = shade(float("nan"))
    with pytest.raises(ValueError, match="embed must return finite"):
        [step(memory, broken.clone()) for _ in range(20)]


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("arguments", CAPACITIES)
def test_on_a_gpu_it_does_the_same(arguments):
    check_far(WaypointMemory, lambda data: data.cuda(), **arguments)
