import copy
import io

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.exploring import explore_settings, world_of
from tests.fakes import FakeMaze
from toponav.config import SettingsError
from toponav.keys import ACTION, FRAME_STACK, INTRINSIC_REWARD
from toponav.methods.rewards import (
    BayesianDynamics,
    DynamicsTrainer,
    InformationGainReward,
    make_reward,
)
from toponav.methods.rewards.icm import GreyStack
from toponav.methods.rewards.vime import VIMEMethod

ACTIONS = 3


def make_dynamics(seed: int = 0) -> BayesianDynamics:
    torch.manual_seed(seed)
    return BayesianDynamics((2,), ACTIONS, hidden=8)


def draw_decisions(num: int = 40, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Points that action 0 leaves where they are, and others move to the right."""
    generator = torch.Generator().manual_seed(seed)
    before = 3 + 2 * torch.randn(num, 2, generator=generator)
    action = torch.randint(ACTIONS, (num,), generator=generator)
    return before, action, before + torch.stack([action, 0 * action], -1)


def test_gains_are_divided_by_the_mean_of_the_last_ten_medians() -> None:
    dynamics = make_dynamics()
    decisions = draw_decisions()
    # Nothing is known of their size before the first batch.
    assert not dynamics(*decisions).any()
    torch.manual_seed(1)
    gain = dynamics.gain(*decisions)
    # Medians 2 and 4: their mean is 3.
    for gains in ([1.0, 2.0, 30.0], [4.0, 4.0, 9.0]):
        dynamics.count_median(torch.tensor(gains))
    torch.manual_seed(1)
    torch.testing.assert_close(dynamics(*decisions), gain / 3)
    # Of twelve medians 2, 4, 1, ..., 10 the last ten are 1, ..., 10.
    for number in range(1, 11):
        dynamics.count_median(torch.full((3,), float(number)))
    assert float(dynamics.scale) == 5.5


def test_gains_have_a_bound() -> None:
    dynamics = BayesianDynamics((2,), ACTIONS, step_size=1e6)
    assert set(dynamics.gain(*draw_decisions()).tolist()) == {1000.0}


def test_observations_are_standardised_and_actions_are_not() -> None:
    dynamics = make_dynamics()
    # Means 2 and 5; deviations 1 and, of a constant, the least one.
    dynamics.count(torch.tensor([[1.0, 5.0], [3.0, 5.0]]))
    assert dynamics.deviation.tolist() == pytest.approx([1, 1e-6])
    inputs, outcomes = dynamics.standardise(
        torch.tensor([[4.0, 5.0]]), torch.tensor([2]), torch.tensor([[0.0, 5.0]])
    )
    assert inputs.tolist() == [[2, 0, 0, 0, 1]]
    assert outcomes.tolist() == [[-2, 0]]


def test_bytes_are_divided_by_255() -> None:
    dynamics = BayesianDynamics((1, 2, 1), ACTIONS, least_deviation=1 / 255)
    views = torch.tensor([0, 51, 255, 102]).byte().reshape(2, 1, 2, 1)
    assert dynamics.flat(views).flatten().tolist() == pytest.approx([0, 0.2, 1, 0.4])


def test_surprises_pay_more_once_the_rest_is_known() -> None:
    torch.manual_seed(0)
    dynamics = BayesianDynamics((2,), ACTIONS, noise_deviation=0.5)
    trainer = DynamicsTrainer(dynamics, lr=0.03, minibatch=50)
    for seed in range(4):
        measured = trainer.extend(*draw_decisions(500, seed))
    # Of 1 for who always predicts the mean.
    assert measured["prediction_error"] < 0.2
    assert measured["median_gain"] == pytest.approx(float(dynamics.medians[-1]))
    before, action, after = draw_decisions(200, 9)
    known = dynamics(before, action, after).median()
    assert dynamics(before, action, after + 6).median() > 5 * known


def test_only_the_newest_decisions_are_kept() -> None:
    trainer = DynamicsTrainer(make_dynamics(), capacity=50, update_rate=0.01)
    trainer.extend(*draw_decisions(40))
    before, action, after = draw_decisions(30, 1)
    trainer.extend(before, action, after)
    kept = trainer.kept[:]["before"]
    assert len(kept) == 50
    assert all((kept == one).all(-1).any() for one in before)


def test_an_env_pays_it() -> None:
    dynamics = BayesianDynamics((5, 6, 1), 6, hidden=4, least_deviation=1 / 255)
    dynamics.count_median(torch.ones(1))
    env = TransformedEnv(
        FakeMaze(batch_size=(3,), max_decisions=4),
        Compose(GreyStack((5, 6), 1), InformationGainReward(dynamics, eta=0.5)),
    )
    check_env_specs(env)
    torch.manual_seed(2)
    start = env.reset()
    action = torch.tensor([0, 1, 2])
    torch.manual_seed(2)
    step = env.step(start.set(ACTION, action))
    torch.manual_seed(2)
    gain = dynamics(start[FRAME_STACK], action, step["next", FRAME_STACK])
    assert gain.all()
    found = step["next", INTRINSIC_REWARD]
    torch.testing.assert_close(found, 0.5 * gain.unsqueeze(-1))


def make_method(*overrides: str) -> VIMEMethod:
    config = explore_settings("reward=vime", "reward.hidden=4", *overrides)
    method = make_reward(config, world_of(config), None)
    assert isinstance(method, VIMEMethod)
    return method


def make_batch(seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    stacks = torch.randint(256, (2, 4, 8, 21, 21, 1), generator=generator)
    before, after = stacks.to(torch.uint8)
    action = torch.randint(6, (4, 8), generator=generator)
    entries = {FRAME_STACK: before, ACTION: action, "next": {FRAME_STACK: after}}
    return TensorDict(entries, [4, 8])


def test_a_method_that_was_saved_continues_exactly() -> None:
    whole, other = make_method(), make_method("seed=1")
    whole.extend(make_batch())
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    measured = []
    for method in (whole, other):
        torch.manual_seed(0)
        measured.append(method.extend(make_batch(1)))
    assert measured[0] == measured[1]
    pairs = zip(
        whole.dynamics.state_dict().values(),
        other.dynamics.state_dict().values(),
        strict=True,
    )
    assert all(torch.equal(one, two) for one, two in pairs if not one.isnan().any())
    assert len(other.kept) == 64


def test_a_checkpoint_holds_what_was_kept_and_no_empty_memory() -> None:
    method = make_method("reward.capacity=100000")
    method.extend(make_batch())
    for name in ("dynamics", "optimizer"):
        setattr(method, name, torch.nn.Identity())
    file = io.BytesIO()
    torch.save(method.state_dict(), file)
    # 32 decisions of 890 bytes; the empty memory is 89 MB.
    assert file.tell() < 50_000


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"reward.step_size must be above 0, got 0"):
        explore_settings("reward=vime", "reward.step_size=0")


def test_its_state_is_numbers_alone_before_its_first_batch() -> None:
    # A checkpoint with NaN is refused, and the run could not be resumed.
    dynamics = BayesianDynamics((2,), num_actions=2)
    assert all(one.isfinite().all() for one in dynamics.state_dict().values())
    assert dynamics.scale.isnan()
