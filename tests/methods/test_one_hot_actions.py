"""One-hot actions, which TorchRL's `GymEnv` has by default, are read or refused."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import one_hot
from torchrl.envs import TransformedEnv
from torchrl.envs.libs.gym import GymEnv

from tests.exploring import explore_settings
from toponav.data import HeldOut, LPairs, MinedPairs
from toponav.graph import MapRules, TopologicalMap, Trajectories
from toponav.keys import ACTION, EMBEDDING, NETWORK_PIXELS, TRAJECTORY
from toponav.methods import LEARNERS
from toponav.methods.rewards import BayesianDynamics, IntrinsicCuriosity
from toponav.methods.rewards.icm import CuriosityReward
from toponav.methods.rewards.vime import DynamicsTrainer, InformationGainReward
from toponav.transforms import PreviousAction

ACTIONS = 4
NUMBERS = torch.tensor([[2, 0, 3], [1, 1, 2]])


def curiosity() -> tuple[Callable, Tensor]:
    icm = IntrinsicCuriosity(ACTIONS, size=(8, 8), frames=1)
    return CuriosityReward(icm, 1.0), torch.zeros(2, 3, 8, 8, 1, dtype=torch.uint8)


def information_gain() -> tuple[Callable, Tensor]:
    dynamics = BayesianDynamics((2,), ACTIONS, hidden=4)
    dynamics.count_median(torch.ones(3))
    reward = InformationGainReward(dynamics, 1.0, key="frame_stack")
    return reward, torch.ones(2, 3, 2)


@pytest.mark.parametrize("make", [curiosity, information_gain])
def test_rewards_by_a_model_read_both(make: Callable) -> None:
    torch.manual_seed(0)
    reward, seen = make()
    found = []
    for action in (NUMBERS, one_hot(NUMBERS, ACTIONS), NUMBERS.unsqueeze(-1)):
        torch.manual_seed(0)  # a Bayesian network draws
        before = TensorDict({"frame_stack": seen, ACTION: action}, [2, 3])
        after = TensorDict({"frame_stack": seen}, [2, 3])
        found.append(reward._step(before, after)["intrinsic_reward"])
    assert found[0].shape == (2, 3, 1)
    # It depends on the action.
    assert len(found[0].unique()) > 1
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


def test_models_are_trained_by_both() -> None:
    measured = []
    for action in (NUMBERS, one_hot(NUMBERS, ACTIONS)):
        torch.manual_seed(0)
        trainer = DynamicsTrainer(BayesianDynamics((2,), ACTIONS, hidden=4))
        measured.append(trainer.extend(torch.rand(3, 2), action[0], torch.rand(3, 2)))
    assert measured[0] == measured[1]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            one_hot(NUMBERS, 5),
            r"numbers \[2, 3\] or one-hot \[2, 3, 4\], got \[2",
        ),
        (NUMBERS.float(), r"action must be integers or bools, .* got torch.float32"),
    ],
)
def test_other_actions_are_refused(action: Tensor, message: str) -> None:
    reward, seen = curiosity()
    data = TensorDict({"frame_stack": seen, ACTION: action}, [2, 3])
    with pytest.raises(ValueError, match=message):
        reward._step(data, data.copy())
    with pytest.raises(ValueError, match=message):
        PreviousAction(ACTIONS)._step(data, data.copy())


def make_frames(action: Tensor) -> TensorDict:
    step = torch.arange(30)
    entries = {NETWORK_PIXELS: torch.rand(30, 2), ACTION: action, "step_count": step}
    return TensorDict({**entries, TRAJECTORY: torch.zeros(30).long()}, [30])


def test_pairs_have_numbers() -> None:
    numbers = torch.arange(30) % ACTIONS
    rows = {True: [], False: []}
    for is_one_hot, found in rows.items():
        torch.manual_seed(0)
        frames = make_frames(one_hot(numbers, ACTIONS) if is_one_hot else numbers)
        _, pairs = MinedPairs(frames, num_frames=40, embed_tc=torch.Tensor.float)()
        held_out = HeldOut(frames.unsqueeze(0), name="maze1")
        found += [pairs[ACTION], held_out.draw(LPairs(4), 10, seed=0).action]
    for one, other in zip(*rows.values(), strict=True):
        assert torch.equal(one, other)


def test_a_map_keeps_walks_of_numbers() -> None:
    def compare(one: Tensor, many: Tensor) -> Tensor:
        return 1 / (1 + (one.unsqueeze(1) - many).abs().sum(-1))

    rules = MapRules(tc_threshold=0.9, tc_reach=0.7)
    for action in (NUMBERS[0], one_hot(NUMBERS[0], ACTIONS)):
        walks = Trajectories()
        known = TopologicalMap(torch.Tensor.float, compare, rules, walks=walks)
        known.add_episode(
            TensorDict({EMBEDDING: torch.rand(3, 2), ACTION: action}, [3])
        )
        assert walks.all()[0].actions.tolist() == [2, 0, 3]


@pytest.mark.parametrize("loss", ["dqn", "drqn"])
def test_a_policy_of_values_refuses_an_env_that_would_misread_it(loss: str) -> None:
    words = "reward=extrinsic", "maze.goal=true", "policy.view_size=36"
    config = explore_settings(f"loss={loss}", *words)
    policy = LEARNERS[loss].make_network(config, 2)
    rule = "must be .*OneHot .or categorical_action_encoding=True of the env.* False"
    with pytest.raises(ValueError, match=rule):
        make_cart_pole(policy, is_one_hot=True).reset()
    primed = make_cart_pole(policy, is_one_hot=False).reset()
    assert "recurrent_state" in primed


def make_cart_pole(policy, *, is_one_hot: bool) -> TransformedEnv:
    env = GymEnv("CartPole-v1", categorical_action_encoding=not is_one_hot)
    return TransformedEnv(env, policy.make_tensordict_primer())
