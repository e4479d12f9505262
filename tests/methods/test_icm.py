import copy

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.checks import check_transform
from tests.exploring import explore_settings, world_of
from tests.fakes import FakeMaze
from toponav.config import SettingsError
from toponav.keys import ACTION, FRAME_STACK, INTRINSIC_REWARD
from toponav.methods.rewards import IntrinsicCuriosity, make_reward
from toponav.methods.rewards.icm import CuriosityReward, GreyStack, ICMMethod

SIZE, FRAMES, ACTIONS = (12, 16), 3, 6


def make_icm(seed: int = 0, *, trains: bool = True) -> IntrinsicCuriosity:
    torch.manual_seed(seed)
    return IntrinsicCuriosity(
        ACTIONS, size=SIZE, frames=FRAMES, forward_trains_features=trains
    )


def draw_decisions(num: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Stacks before, actions, stacks after: noise in which each action lights a row."""
    generator = torch.Generator().manual_seed(seed)
    shape = (2, num, *SIZE, FRAMES)
    before, after = torch.randint(100, shape, generator=generator).to(torch.uint8)
    action = torch.randint(ACTIONS, (num,), generator=generator)
    after[torch.arange(num), 2 * action] = 255
    return before, action, after


def losses(icm: IntrinsicCuriosity, seed: int = 0) -> tuple[Tensor, Tensor]:
    before, action, after = draw_decisions(32, seed)
    logits, error = icm(before, action, after)
    return nn.functional.cross_entropy(logits, action), error.mean()


def make_env(batch_size=(3,), **arguments: object) -> TransformedEnv:
    env = FakeMaze(batch_size=batch_size, max_decisions=4, image_size=SIZE)
    return TransformedEnv(env, Compose(GreyStack(SIZE, FRAMES), *arguments.values()))


def test_the_papers_sizes() -> None:
    icm = IntrinsicCuriosity(4)
    shapes = {name: tuple(p.shape) for name, p in icm.named_parameters() if p.ndim > 1}
    assert list(shapes.values()) == [
        (32, 4, 3, 3),
        *[(32, 32, 3, 3)] * 3,
        (256, 2 * 288),
        (4, 256),
        (256, 288 + 4),
        (288, 256),
    ]
    # Every unit's weights have the norm 0.01 that the authors' code gives them.
    norms = icm.forward_model[0].weight.norm(dim=-1)
    torch.testing.assert_close(norms, torch.full((256,), 0.01))
    stacks = torch.zeros(2, 42, 42, 4, dtype=torch.uint8)
    assert icm.features(stacks).shape == (2, 288)


def test_the_error_is_half_the_squared_distance() -> None:
    icm = make_icm()
    before, action, after = draw_decisions(5)
    for parameter in icm.forward_model.parameters():
        nn.init.zeros_(parameter)
    # It predicts 1 for every feature now.
    nn.init.ones_(icm.forward_model[-1].bias)
    expected = 0.5 * (icm.features(after) - 1).square().sum(-1)
    torch.testing.assert_close(icm(before, action, after)[1], expected)
    reshaped = icm(before.unsqueeze(0), action.unsqueeze(0), after.unsqueeze(0))
    assert reshaped[0].shape == (1, 5, ACTIONS)
    torch.testing.assert_close(reshaped[1], expected.unsqueeze(0))


def test_the_forward_model_knows_the_action() -> None:
    icm = make_icm()
    before, action, after = draw_decisions(4)
    other = icm(before, (action + 1) % ACTIONS, after)
    assert not torch.equal(icm(before, action, after)[1], other[1])
    assert torch.equal(icm(before, action, after)[0], other[0])
    # The inverse model sees both views.
    assert not torch.equal(icm(before, action, before)[0], other[0])
    assert not torch.equal(icm(after, action, after)[0], other[0])


@pytest.mark.parametrize("trains", [True, False])
def test_what_trains_the_features(trains: bool) -> None:
    icm = make_icm(trains=trains)
    inverse, forward = losses(icm)
    encoder = list(icm.encoder.parameters())
    models = {
        "inverse": list(icm.inverse_model.parameters()),
        "forward": list(icm.forward_model.parameters()),
    }
    for loss, own, reaches in (
        (inverse, "inverse", True),
        (forward, "forward", trains),
    ):
        wanted = {name: [*encoder, *weights] for name, weights in models.items()}
        for name, weights in wanted.items():
            found = torch.autograd.grad(
                loss, weights, retain_graph=True, allow_unused=True
            )
            of_encoder, of_model = found[: len(encoder)], found[len(encoder) :]
            assert all((one is not None) == reaches for one in of_encoder)
            assert all((one is not None) == (name == own) for one in of_model)


def test_decisions_learned_pay_less_than_others_and_actions_are_named() -> None:
    icm = make_icm()
    before, action, after = draw_decisions(64)
    strange = after.clone()
    strange[:, 6:, 8:] = 255
    optimizer = torch.optim.Adam(icm.parameters(), lr=3e-3)
    for _ in range(60):
        logits, error = icm(before, action, after)
        loss = 0.8 * nn.functional.cross_entropy(logits, action) + 0.2 * error.mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        logits, error = icm(before, action, after)
        unforeseen = icm(before, action, strange)[1].mean()
        spread = 0.5 * icm.features(after).var(0).sum()
    assert (logits.argmax(-1) == action).float().mean() > 0.95
    assert error.mean() < 0.5 * spread
    assert unforeseen > 2 * error.mean()


def test_specs_of_the_stack_hold_under_every_nesting() -> None:
    check_transform(
        lambda batch_size: FakeMaze(batch_size=batch_size, max_decisions=4),
        lambda: GreyStack((5, 6), FRAMES),
    )


def test_a_stack_is_grey_and_grows_from_black() -> None:
    red = torch.zeros(1, *SIZE, 3, dtype=torch.uint8)
    red[..., 0] = 255
    stack = GreyStack(SIZE, FRAMES)
    start = stack._reset(TensorDict(), TensorDict({"pixels": red}, [1]))
    # 0.299 * 255 = 76.2
    assert start[FRAME_STACK][0, 0, 0].tolist() == [0, 0, 76]
    following = TensorDict({"pixels": torch.full_like(red, 9)}, [1])
    following = stack._step(start, following)
    assert following[FRAME_STACK][0, 0, 0].tolist() == [0, 76, 9]
    assert start[FRAME_STACK].dtype == torch.uint8


def test_no_stack_reaches_over_the_end_of_an_episode() -> None:
    steps = make_env().rollout(10, break_when_any_done=False)
    done = steps["next", "done"][:, :-1, 0]
    assert done.any()
    ended, now = steps["next", FRAME_STACK][:, :-1], steps[FRAME_STACK][:, 1:]
    assert torch.equal(ended[~done], now[~done])
    assert not now[done][..., :-1].any()
    assert ended[done][..., :-1].any()


def test_an_env_pays_it() -> None:
    reward = CuriosityReward(make_icm(), eta=0.5)
    env = make_env(reward=reward)
    check_env_specs(env)
    steps = env.rollout(9, break_when_any_done=False)
    stacks = steps[FRAME_STACK], steps["next", FRAME_STACK]
    error = make_icm()(stacks[0], steps[ACTION], stacks[1])[1]
    paid = steps["next", INTRINSIC_REWARD]
    assert paid.shape == (3, 9, 1)
    assert not paid.requires_grad
    torch.testing.assert_close(paid.squeeze(-1), 0.5 * error.detach())


def make_method(*overrides: str) -> ICMMethod:
    config = explore_settings("reward=icm", *overrides)
    method = make_reward(config, world_of(config), None)
    assert isinstance(method, ICMMethod)
    return method


def make_batch(seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    stacks = torch.randint(256, (2, 4, 8, 42, 42, 4), generator=generator)
    before, after = stacks.to(torch.uint8)
    action = torch.randint(ACTIONS, (4, 8), generator=generator)
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
    for one, two in zip(whole.icm.parameters(), other.icm.parameters(), strict=True):
        assert torch.equal(one, two)


def test_its_losses_are_weighed_by_beta() -> None:
    learned = {}
    for beta in (0.0, 1.0):
        method = make_method(f"reward.beta={beta}")
        before = copy.deepcopy(method.icm)
        measured = method.extend(make_batch())
        # Near the logarithm of six actions, of which the model knows nothing yet.
        assert measured["loss_inverse"] == pytest.approx(1.79, abs=0.02)
        learned[beta] = {
            name.split(".")[0]
            for name, value in method.icm.named_parameters()
            if not torch.equal(value, before.get_parameter(name))
        }
    assert learned == {
        0.0: {"encoder", "inverse_model"},
        1.0: {"encoder", "forward_model"},
    }


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("reward.eta=0", "reward.eta must be above 0, got 0"),
        ("reward.beta=2", r"reward.beta must lie in \[0, 1\], got 2"),
    ],
)
def test_settings_out_of_range_are_refused(word: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        explore_settings("reward=icm", word)
