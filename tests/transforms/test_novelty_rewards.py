from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from tests.checks import check_transform
from tests.fakes import FakeMaze
from tests.transforms.colour_world import make_memory, reset, shade, step
from toponav import keys
from toponav.transforms import (
    CountReward,
    IntrinsicReward,
    TemporalDistanceReward,
    WaypointMemory,
)

ALPHA, BETA = 0.2, 0.8


def pay(way, *, combine="exclusive", **guards):
    """What each part and both pay for a walk through shades of grey."""
    memory = make_memory(**guards)
    parts = [
        CountReward(ALPHA, combine=combine),
        TemporalDistanceReward(BETA, combine=combine),
        IntrinsicReward(),
    ]
    reset(memory, shade(way[0]))
    walk = [step(memory, shade(grey)) for grey in way[1:]]
    for data in walk:
        for part in parts:
            part(data)
    names = keys.COUNT_REWARD, keys.TEMPORAL_DISTANCE_REWARD, keys.INTRINSIC_REWARD
    return [[data[name].item() for data in walk] for name in names]


WAY = [0.0, 0.125, 0.5, 0.5]


def test_exclusive_worked_numbers():
    count, distance, both = pay(WAY)
    # A second visit, 0.2 / sqrt(2); a new waypoint at similarity 0.5, 0.8 / 0.5; and a
    # second visit of the new waypoint.
    assert count == pytest.approx([0.141421, 0, 0.141421], abs=1e-6)
    assert distance == pytest.approx([0, 1.6, 0])
    assert both == pytest.approx([0.141421, 1.6, 0.141421], abs=1e-6)


def test_sum_worked_numbers():
    count, distance, both = pay(WAY, combine="sum")
    # The new waypoint counts as a first visit; similarities 0.875, 0.5 and 1 pay, too.
    assert count == pytest.approx([0.141421, 0.2, 0.141421], abs=1e-6)
    assert distance == pytest.approx([0.8 / 0.875, 1.6, 0.8])
    assert both == pytest.approx([1.055707, 1.8, 0.941421], abs=1e-6)


@pytest.mark.parametrize("combine", ["exclusive", "sum"])
def test_the_parts_add_up(combine):
    way = torch.rand(60, generator=torch.Generator().manual_seed(0)).tolist()
    count, distance, both = pay(way, combine=combine, persistence=2)
    assert sum(distance) > 1
    parts = [one + other for one, other in zip(count, distance, strict=True)]
    assert both == pytest.approx(parts)


def test_waiting_to_become_a_waypoint_pays_nothing():
    _, distance, both = pay([0.0, 0.5, 0.5, 0.5, 0.5], persistence=3)
    # Novel twice, then a waypoint at similarity 0.5, then known.
    assert distance == pytest.approx([0, 0, 1.6, 0])
    assert both[:2] == [0, 0]


def test_a_full_memory_pays_for_no_new_place():
    _, distance, both = pay([0.0, 1.0, 1.0, 1.0], capacity=1)
    assert distance == [0, 0, 0]
    assert both == [0, 0, 0]


def test_novel_in_place_of_new_pays_while_waiting():
    memory = make_memory(persistence=9)
    reward = TemporalDistanceReward(BETA, in_keys=[keys.SIMILARITY, keys.NOVEL])
    reset(memory, shade(0.0))
    data = reward(step(memory, shade(0.5)))
    assert data[keys.TEMPORAL_DISTANCE_REWARD].item() == pytest.approx(1.6)


def test_staying_pays_nothing_when_entries_are_counted():
    count, _, _ = pay([0.0, 0.0, 0.5, 0.5, 0.0], count_on="entry")
    assert count == pytest.approx([0, 0, 0, 0.141421], abs=1e-6)


def test_the_floor_is_used():
    data = TensorDict({"similarity": torch.tensor([[0.0], [0.4]])}, [2])
    data["is_new_waypoint"] = torch.ones(2, 1) > 0
    reward = TemporalDistanceReward(BETA, floor=0.2)(data)
    found = reward[keys.TEMPORAL_DISTANCE_REWARD].squeeze(-1).tolist()
    assert found == pytest.approx([4.0, 2.0])


@pytest.mark.parametrize(
    "part", [CountReward(ALPHA), TemporalDistanceReward(BETA), IntrinsicReward()]
)
def test_a_missing_entry_is_named(part):
    with pytest.raises(KeyError, match=r"must have .\w+.: add \w+, got .*other"):
        part(TensorDict({"other": torch.zeros(1)}))


def first_pixel(views):
    return views[..., 0, 0, :].float() / 255


def closeness(one, many):
    return (-4 * (one.unsqueeze(-2) - many).norm(dim=-1)).exp()


def make_rewards(count="count_reward", distance="temporal_distance_reward"):
    return Compose(
        WaypointMemory(first_pixel, closeness, threshold=0.8),
        CountReward(ALPHA, out_keys=[count]),
        TemporalDistanceReward(BETA, out_keys=[distance]),
        IntrinsicReward(in_keys=[count, distance], out_keys=[("all", "paid")]),
    )


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def test_specs_hold_for_nested_keys():
    check_transform(make_maze, partial(make_rewards, ("all", "count"), ("all", "far")))


def test_the_tasks_reward_is_untouched():
    torch.manual_seed(0)
    env = TransformedEnv(make_maze([4]), make_rewards())
    data = env.rollout(30, break_when_any_done=False)["next"]
    assert set(data["reward"].unique().tolist()) <= {0.0, 10.0}
    assert data["all", "paid"].shape == (4, 30, 1)
    assert data["all", "paid"].dtype is torch.float32
    assert (data["all", "paid"] > 0).any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (partial(CountReward, -1.0), "alpha must be at least 0, got -1.0"),
        (partial(TemporalDistanceReward, -1.0), "beta must be at least 0, got -1.0"),
        (partial(TemporalDistanceReward, 1.0, floor=2.0), r"floor must be in \(0, 1\]"),
        (partial(CountReward, 1.0, combine="both"), "combine must be one of"),
        (partial(TemporalDistanceReward, 1.0, combine="mean"), "one of .* got 'mean'"),
        (partial(CountReward, 1.0, in_keys=["n"]), "in_keys must be 2 and out_keys 1"),
        (partial(IntrinsicReward, in_keys=["n"]), "in_keys must be 2 and out_keys 1"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("chain", "message"),
    [
        (
            [CountReward(ALPHA)],
            "'visits' must be an observation or a reward of the env",
        ),
        (
            [make_memory(), CountReward(ALPHA), IntrinsicReward()],
            "'temporal_distance_reward' must be an observation or a reward",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_the_specs(chain, message):
    env = TransformedEnv(FakeMaze(), Compose(*chain))
    with pytest.raises(ValueError, match=message):
        env.output_spec  # noqa: B018
