import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.transforms import RNDTransform
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.rnd import RNDLoss

from tests.fakes import FakeMaze
from toponav.methods.rewards import RandomNetworkDistillation
from toponav.transforms import PolicyPixels

SIZE = (40, 36)


def make_rnd(seed: int = 0) -> RandomNetworkDistillation:
    torch.manual_seed(seed)
    return RandomNetworkDistillation(SIZE, width=4, feature_dim=16)


def make_transform(rnd: RandomNetworkDistillation, key: str = "pixels") -> RNDTransform:
    return RNDTransform(
        rnd.target,
        rnd.predictor,
        in_keys=[key],
        normalize_obs=False,
        normalize_reward=False,
    )


def draw_views(num: int, *, seed: int = 0, high: int = 256) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    shape = (num, *SIZE, 3)
    return torch.randint(high, shape, dtype=torch.uint8, generator=generator)


def reward_of(rnd: RandomNetworkDistillation, views: Tensor) -> Tensor:
    step = TensorDict({"pixels": views}, views.shape[:-3])
    reward: Tensor = make_transform(rnd)._step(step, step)["intrinsic_reward"]
    return reward


def test_views_learned_pay_less_than_new_ones() -> None:
    rnd = make_rnd()
    known, unknown = draw_views(8, high=128), draw_views(8, seed=1, high=128)
    unknown[:, 10:30, 10:30] = 255
    rnd.update(torch.cat([known, unknown]))
    before = reward_of(rnd, known).mean()
    loss = RNDLoss(rnd.predictor, rnd.target, update_fraction=1.0)
    loss.set_keys(observation=("next", "pixels"))
    batch = TensorDict({"next": {"pixels": known}}, [8])
    assert loss(batch)["loss_predictor"] == before
    optimizer = torch.optim.Adam(rnd.predictor.parameters(), lr=3e-3)
    for _ in range(60):
        optimizer.zero_grad()
        loss(batch)["loss_predictor"].backward()
        optimizer.step()
    assert reward_of(rnd, known).mean() < 0.2 * before
    assert reward_of(rnd, unknown).mean() > 2 * reward_of(rnd, known).mean()


def test_frames_are_grey_centred_scaled_and_clipped_per_pixel() -> None:
    rnd = make_rnd()
    frames = rnd.target.frames
    views = draw_views(2000)
    views[:, :, 0] = views[:, :, 0] // 64 + 100  # a column of little contrast
    rnd.update(views.reshape(4, 500, *views.shape[1:]))
    seen = frames(views)
    assert seen.shape == (2000, 1, *SIZE)
    torch.testing.assert_close(seen.mean(0), torch.zeros(1, *SIZE), atol=1e-4, rtol=0)
    # Not quite 1 where contrast is low: TorchRL's statistics begin with a variance of 1
    # at a count of 1e-4.
    deviation = seen.std(0, correction=0)
    torch.testing.assert_close(deviation, torch.ones(1, *SIZE), atol=5e-3, rtol=0)
    views[0, 0, 0] = 255
    assert frames(views[:1])[0, 0, 0, 0] == 5
    # Worked out for one red pixel: 0.299 * 255 / 255.
    red = torch.zeros(1, *SIZE, 3, dtype=torch.uint8)
    red[..., 0] = 255
    fresh = make_rnd().target.frames
    torch.testing.assert_close(fresh(red), torch.full((1, 1, *SIZE), 0.299))


def test_only_update_changes_the_statistics() -> None:
    rnd = make_rnd().train()
    before = {name: value.clone() for name, value in rnd.state_dict().items()}
    reward_of(rnd, draw_views(4))
    assert all(torch.equal(rnd.state_dict()[name], before[name]) for name in before)


def test_who_loads_the_state_pays_the_same() -> None:
    rnd, other = make_rnd(0), make_rnd(1)
    views = draw_views(4)
    rnd.update(views)
    assert not torch.equal(reward_of(other, views), reward_of(rnd, views))
    other.load_state_dict(rnd.state_dict())
    assert torch.equal(reward_of(other, views), reward_of(rnd, views))


def test_gradients_reach_the_predictor_alone() -> None:
    rnd = make_rnd()
    loss = RNDLoss(rnd.predictor, rnd.target, update_fraction=1.0)
    loss.set_keys(observation=("next", "pixels"))
    loss(TensorDict({"next": {"pixels": draw_views(4)}}, [4]))[
        "loss_predictor"
    ].backward()
    assert all(p.grad is not None for p in rnd.predictor.parameters())
    assert not any(p.requires_grad for p in rnd.target.parameters())


def test_the_papers_widths() -> None:
    rnd = RandomNetworkDistillation((84, 84))
    target, predictor = (
        [
            tuple(layer.weight.shape)
            for layer in network.modules()
            if isinstance(layer, nn.Conv2d | nn.Linear)
        ]
        for network in (rnd.target, rnd.predictor)
    )
    convolutions = [(32, 1, 8, 8), (64, 32, 4, 4), (64, 64, 3, 3)]
    assert target == [*convolutions, (512, 64 * 7 * 7)]
    assert predictor == [*target, (512, 512), (512, 512)]


def test_an_env_pays_it() -> None:
    env = TransformedEnv(
        FakeMaze(batch_size=[3]),
        Compose(PolicyPixels(SIZE), make_transform(make_rnd(), "policy_pixels")),
    )
    check_env_specs(env)
    rollout = env.rollout(4)
    rewards = rollout["next", "intrinsic_reward"]
    assert rewards.shape == (3, 4, 1)
    expected = reward_of(make_rnd(), rollout["next", "policy_pixels"])
    torch.testing.assert_close(rewards, expected)


def test_batch_dimensions_are_kept() -> None:
    rnd = make_rnd()
    views = draw_views(6)
    rewards = reward_of(rnd, views.reshape(2, 3, *SIZE, 3))
    assert rewards.shape == (2, 3, 1)
    torch.testing.assert_close(rewards.reshape(6, 1), reward_of(rnd, views))


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"at least 36 both ways, got \(84, 20\)"):
        RandomNetworkDistillation((84, 20))
    with pytest.raises(ValueError, match=r"\[40, 36, 3\].*got \[2, 84, 84, 3\]"):
        make_rnd().update(torch.zeros(2, 84, 84, 3))
