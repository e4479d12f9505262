import copy
import io
import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.exploring import explore_settings, world_of
from tests.fakes import FakeMaze
from toponav.config import SettingsError
from toponav.keys import INTRINSIC_REWARD, SMALL_PIXELS
from toponav.methods.rewards import (
    AmortisedExemplars,
    ExemplarReward,
    ExemplarTrainer,
    make_reward,
)
from toponav.methods.rewards.ex2 import EX2Method
from toponav.transforms import PolicyPixels

#: How often each of four places was seen.
DENSITY = torch.tensor([0.5, 0.3, 0.15, 0.05])


def make_trainer(**given: float) -> ExemplarTrainer:
    torch.manual_seed(0)
    exemplars = AmortisedExemplars((4,))
    return ExemplarTrainer(exemplars, **{"lr": 6e-3, "pairs": 64, **given})


def draw_places(weights: Tensor, num: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.eye(4)[torch.multinomial(weights, num, True, generator=generator)]


def test_it_knows_how_often_places_were_seen() -> None:
    trainer = make_trainer(update_rate=0.5)
    places = torch.eye(4)
    assert trainer.extend(draw_places(DENSITY, 4000)) == {}
    assert not trainer.exemplars(places).any()
    # All alike in the batch that it is fitted to: only what was before counts.
    measured = trainer.extend(draw_places(torch.ones(4), 400))
    with torch.no_grad():
        logit = trainer.exemplars.logit(places)
    # The best classifier says D = 1 / (1 + p), so p = exp(-logit).
    torch.testing.assert_close((-logit).exp(), DENSITY, rtol=0.5, atol=0)
    # The mean of D is (0.667 + 0.769 + 0.870 + 0.952) / 4.
    assert measured["true_probability"] == pytest.approx(0.81, abs=0.06)
    bonus = trainer.exemplars(places)
    assert bonus.argsort().tolist() == [0, 1, 2, 3]
    # log(0.5 / 0.05) = 2.3
    assert float(bonus[3] - bonus[0]) == pytest.approx(math.log(10), abs=0.6)


def test_the_median_of_the_batch_earns_nothing() -> None:
    trainer = make_trainer(update_rate=0.1)
    trainer.extend(draw_places(DENSITY, 200))
    for seed in (1, 2):
        batch = draw_places(DENSITY, 201, seed)
        trainer.extend(batch)
        assert float(trainer.exemplars(batch).median()) == pytest.approx(0, abs=1e-6)


def test_the_loss_of_a_classifier_that_knows_nothing() -> None:
    trainer = make_trainer()
    for weight in trainer.exemplars.parameters():
        torch.nn.init.zeros_(weight)
    places = draw_places(DENSITY, 8)
    loss, probability = trainer.exemplars.loss(places, places, kl_weight=1.0)
    # Cross-entropy log 2; the codes are N(0, 1): their KL is 0.
    assert float(loss) == pytest.approx(math.log(2))
    assert float(probability) == 0.5
    for network in (trainer.exemplars.of_exemplar, trainer.exemplars.of_other):
        torch.nn.init.constant_(network.mean[-1].bias, 0.5)
    loss, _ = trainer.exemplars.loss(places, places, kl_weight=1.0)
    # 16 numbers of mean 0.5 in each of two codes: 2 * 16 * 0.5^2 / 2 = 4.
    assert float(loss) == pytest.approx(math.log(2) + 4)


def test_both_codes_matter_and_have_weights_of_their_own() -> None:
    trainer = make_trainer()
    loss, _ = trainer.exemplars.loss(*draw_places(DENSITY, 16).chunk(2), 0.1)
    loss.backward()
    for name, weight in trainer.exemplars.named_parameters():
        assert weight.grad is not None, name
        assert weight.grad.any(), name


def test_logits_have_a_bound() -> None:
    exemplars = make_trainer().exemplars
    torch.nn.init.constant_(exemplars.classifier[-1].bias, 100)
    assert exemplars.logit(torch.eye(4)).tolist() == [11.5] * 4


def test_a_share_of_each_batch_is_kept_after_it_was_judged() -> None:
    trainer = make_trainer(keep_fraction=0.25, update_rate=0.02, capacity=60)
    for number in range(1, 4):
        trainer.extend(draw_places(DENSITY, 100, number))
        assert len(trainer.kept) == min(25 * number, 60)


def test_an_env_pays_it() -> None:
    torch.manual_seed(0)
    exemplars = AmortisedExemplars((5, 6, 3))
    exemplars.fitted.fill_(True)
    views = PolicyPixels((5, 6), out_keys=[SMALL_PIXELS])
    env = TransformedEnv(
        FakeMaze(batch_size=(3,), max_decisions=4),
        Compose(views, ExemplarReward(exemplars, eta=0.5)),
    )
    check_env_specs(env)
    steps = env.rollout(4)
    bonus = exemplars(steps["next", SMALL_PIXELS])
    assert bonus.all()
    found = steps["next", INTRINSIC_REWARD]
    torch.testing.assert_close(found, 0.5 * bonus.unsqueeze(-1))


def make_method(*overrides: str) -> EX2Method:
    config = explore_settings("reward=ex2", "reward.view_size=8", *overrides)
    method = make_reward(config, world_of(config), None)
    assert isinstance(method, EX2Method)
    return method


def make_batch(seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    views = torch.randint(256, (4, 8, 8, 8, 3), generator=generator)
    return TensorDict({"next": {SMALL_PIXELS: views.to(torch.uint8)}}, [4, 8])


def test_a_method_that_was_saved_continues_exactly() -> None:
    whole, other = make_method(), make_method("seed=1")
    for seed in (0, 1):
        whole.extend(make_batch(seed))
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    measured = []
    for method in (whole, other):
        torch.manual_seed(0)
        measured.append(method.extend(make_batch(2)))
    assert measured[0] == measured[1]
    assert set(measured[0]) == {"loss_exemplars", "true_probability"}
    for key, one in whole.exemplars.state_dict().items():
        assert torch.equal(one, other.exemplars.state_dict()[key])


def test_a_checkpoint_holds_what_was_kept_and_no_empty_memory() -> None:
    method = make_method("reward.capacity=100000")
    for name in ("exemplars", "optimizer"):
        setattr(method, name, torch.nn.Identity())
    method.extend(make_batch())
    file = io.BytesIO()
    torch.save(method.state_dict(), file)
    # Three views of 192 bytes; the empty memory is 19 MB.
    assert file.tell() < 10_000


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"reward.pairs must be at least 1, got 0"):
        explore_settings("reward=ex2", "reward.pairs=0")
