import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings, make_batch, world_of
from toponav.keys import INTRINSIC_REWARD
from toponav.methods import make_reward
from toponav.training import EpisodeLog, Row


def make_log(num_envs: int, *overrides: str) -> EpisodeLog:
    config = explore_settings(*overrides)
    world = world_of(config)
    return EpisodeLog(num_envs, world, make_reward(config, world, None))


def add(log: EpisodeLog, batch: TensorDict) -> list[Row]:
    log.extend(batch)
    return log.ended


def test_an_episode_adds_up_over_batches_whoever_else_reports_between() -> None:
    # Episodes of 64 decisions in rollouts of 32: two batches make one.
    config = explore_settings()
    log = make_log(4)
    pieces = {
        envs: [make_batch(config, envs=envs, start=s, seed=s) for s in (0, 32)]
        for envs in ((0, 1), (2, 3))
    }
    assert add(log, pieces[0, 1][0]) == []
    assert add(log, pieces[2, 3][0]) == []
    ended = add(log, pieces[2, 3][1])
    # Batches of 2 environments and 32 decisions: the third one ends at 192.
    assert [row["decisions"] for row in ended] == [192, 192]
    ended += add(log, pieces[0, 1][1])
    assert log.rows == ended
    for row, (envs, place) in zip(
        ended, [((2, 3), 0), ((2, 3), 1), ((0, 1), 0), ((0, 1), 1)], strict=True
    ):
        paid = [piece["next", INTRINSIC_REWARD][place] for piece in pieces[envs]]
        total = float(torch.cat(paid).double().sum())
        assert row["intrinsic_return"] == pytest.approx(total)
        assert row["count_return"] == pytest.approx(0.25 * total, rel=1e-6)
        # Every view of these batches is a new waypoint; none of them is spurious.
        assert (row["new_waypoints"], row["spurious_waypoints"], row["waypoints"]) == (
            64,
            0,
            5,
        )
        last = pieces[envs][1]["next", "privileged", "coverage"][place, -1]
        assert row["coverage"] == pytest.approx(float(last))


def test_what_follows_an_end_belongs_to_the_next_episode() -> None:
    config = explore_settings("maze.episode_length=48")
    log = make_log(2, "maze.episode_length=48")
    batches = [
        make_batch(config, envs=(0, 1), start=start, seed=start)
        for start in (0, 32, 64)
    ]
    ended = [row for batch in batches for row in add(log, batch)]
    assert len(ended) == 4
    paid = torch.cat([batch["next", INTRINSIC_REWARD][0] for batch in batches])
    sums = [float(some.double().sum()) for some in paid.split(48)]
    returns = [row["intrinsic_return"] for row in ended]
    assert returns[::2] == pytest.approx(sums)


def test_episodes_that_were_cut_short_are_not_counted() -> None:
    config = explore_settings("maze.episode_length=48")
    log = make_log(2)
    assert add(log, make_batch(config, envs=(0, 1), start=32)) == []
    assert log.last_episode is None


def test_an_episode_that_the_world_ends_is_whole() -> None:
    config, log = explore_settings(), make_log(2)
    batch = make_batch(config, envs=(0, 1))
    for name in ("done", "terminated", "truncated"):
        batch["next", name] = batch["next", name].clone()
    # Both end after 10 of 64 decisions, the second one because it is cut short.
    batch["next", "done"][:, 9] = True
    batch["next", "terminated"][0, 9] = batch["next", "truncated"][1, 9] = True
    (row,) = add(log, batch)
    paid = batch["next", INTRINSIC_REWARD][0, :10].double().sum()
    assert row["intrinsic_return"] == pytest.approx(float(paid))
    assert log.last_episode is not None
    assert log.last_episode.batch_size == (10,)


def test_the_last_whole_episode_of_the_first_environment_is_kept() -> None:
    config = explore_settings()
    log = make_log(4)
    for start in (0, 32, 64):
        batch = make_batch(config, start=start, seed=start)
        add(log, batch)
        if start == 32:
            last = batch["next", INTRINSIC_REWARD][0]
    assert log.last_episode is not None
    assert log.last_episode.batch_size == (64,)
    assert torch.equal(log.last_episode["next", INTRINSIC_REWARD][32:], last)


def test_episodes_that_run_have_seen_something_too() -> None:
    config, log = explore_settings(), make_log(2)
    batch = make_batch(config, envs=(0, 1))
    coverage = batch["next", "privileged", "coverage"]
    coverage[0, -1], coverage[1, -1] = 0.25, 0.5
    batch["next", "num_waypoints"][:, -1] = torch.tensor([[3], [4]])
    assert log.extend(batch) == {"running_coverage": 0.375, "running_waypoints": 3.5}


def test_episodes_that_run_go_on_in_a_resumed_run() -> None:
    config, whole, resumed = explore_settings(), make_log(4), make_log(4)
    length = config.world.episode_length
    starts = range(0, 3 * length, config.loss.rollout)
    batches = [make_batch(config, start=start, seed=start) for start in starts]
    cut = len(batches) // 2 - 1
    for batch in batches[:cut]:
        add(whole, batch)
    resumed.load_state_dict(whole.state_dict())
    resumed.resume_episodes(whole.running_episodes())
    for batch in batches[cut:]:
        assert add(whole, batch) == add(resumed, batch)
    assert whole.ended
    assert whole.last_episode is not None
    assert (whole.last_episode == resumed.last_episode).all()
