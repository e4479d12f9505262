import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings, world_of
from toponav.methods import make_reward
from toponav.training import BestPolicy, EpisodeLog, ExplorationState

BATCH = TensorDict(batch_size=[0])


@pytest.fixture
def log() -> EpisodeLog:
    config = explore_settings()
    world = world_of(config)
    return EpisodeLog(4, world, make_reward(config, world, None))


def test_the_best_policy_is_the_one_with_most_reward(log: EpisodeLog) -> None:
    policy, state = torch.nn.Linear(1, 1), ExplorationState()
    best = BestPolicy(policy, log, state, metric="intrinsic_return", window=2)

    def end_episode(weight: float, reward: float) -> float:
        """Train to a weight, end an episode; the weight that is kept."""
        torch.nn.init.constant_(policy.weight, weight)
        row = {
            "intrinsic_return": reward,
            "networks_version": state.versions.get("networks", 0),
        }
        log.ended = [row]
        log.rows.append(row)
        best.extend(BATCH)
        return -1 if best.weights is None else best.weights["weight"].item()

    # Means of the last two: none yet, 2, 3, 2.5
    kept = [end_episode(w, reward) for w, reward in ((1, 1), (2, 3), (3, 3), (4, 2))]
    assert kept == [-1, 2, 3, 3]
    assert best.best == 3
    # Returns by another version of the networks do not compare.
    state.versions["networks"] = 1
    assert [end_episode(5, 1), end_episode(6, 1)] == [3, 6]
    assert (best.best, best.best_version) == (1, 1)
    other = BestPolicy(policy, log, state, metric="coverage", window=2)
    other.load_state_dict(best.state_dict())
    assert other.state_dict() == best.state_dict()


def test_a_batch_that_ends_no_episode_changes_nothing(log: EpisodeLog) -> None:
    policy = torch.nn.Linear(1, 1)
    best = BestPolicy(policy, log, ExplorationState(), metric="coverage", window=1)
    log.rows.append({"coverage": 1.0, "networks_version": 0})
    best.extend(BATCH)
    assert best.weights is None
