"""TRPO's loss and its natural gradient steps, against what is computed densely."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from tests.objectives.slices import collected_slice
from tests.objectives.test_a3c_on_cartpole import make_env, make_networks, mean_return
from toponav.objectives import TRPOLoss, TrustRegion, conjugate_gradient

DEVIATION = 0.5


def draw_matrix(size: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(size, size, generator=generator, dtype=torch.float64)
    return root @ root.T + 0.1 * torch.eye(size, dtype=torch.float64)


def test_conjugate_gradients_solve_a_known_system() -> None:
    matrix = torch.tensor([[4.0, 1.0], [1.0, 3.0]], dtype=torch.float64)
    target = torch.tensor([1.0, 2.0], dtype=torch.float64)
    # The inverse is [[3, -1], [-1, 4]] / 11.
    found = conjugate_gradient(matrix.mv, target, iterations=2)
    torch.testing.assert_close(found, torch.tensor([1 / 11, 7 / 11]).double())
    # The first step is along the target: |b|^2 / b'Ab = 5 / 20.
    first = conjugate_gradient(matrix.mv, target, iterations=1)
    torch.testing.assert_close(first, 0.25 * target)


def test_they_need_as_many_iterations_as_there_are_unknowns() -> None:
    matrix, target = draw_matrix(6), torch.arange(1.0, 7.0).double()
    expected = torch.linalg.solve(matrix, target)
    errors = [
        float((conjugate_gradient(matrix.mv, target, number) - expected).norm())
        for number in (3, 6)
    ]
    assert errors[1] < 1e-6 < errors[0]


def test_they_end_when_nothing_is_left() -> None:
    calls = []

    def product(vector: Tensor) -> Tensor:
        calls.append(vector)
        return 2 * vector

    small = 1e-7 * torch.ones(3)
    torch.testing.assert_close(conjugate_gradient(product, small, 10), small / 2)
    assert len(calls) == 1
    assert not conjugate_gradient(product, torch.zeros(3), 10).any()


class Line(nn.Module):
    """A linear policy: the mean of a Gaussian of known deviation."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(2, 1)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        mean = self.linear(observation)
        return mean, torch.full_like(mean, DEVIATION)


def make_gaussian(seed: int = 0) -> tuple[TRPOLoss, TensorDict]:
    """The loss of a linear-Gaussian policy, and a prepared batch of it."""
    torch.manual_seed(seed)
    actor = ProbabilisticActor(
        TensorDictModule(Line(), ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        distribution_kwargs={"tanh_loc": False},
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(2, 1, num_cells=[8]), ["observation"])
    return TRPOLoss(actor, critic), make_batch(actor)


def make_categorical(seed: int = 0) -> tuple[TRPOLoss, TensorDict]:
    torch.manual_seed(seed)
    actor = ProbabilisticActor(
        TensorDictModule(nn.Linear(2, 3), ["observation"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(2, 1, num_cells=[8]), ["observation"])
    return TRPOLoss(actor, critic), make_batch(actor)


def make_batch(actor: ProbabilisticActor) -> TensorDict:
    steps = TensorDict({"observation": torch.randn(4, 30, 2)}, [4, 30])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        steps = actor(steps)
    flags = torch.zeros(4, 30, 1, dtype=torch.bool)
    following = {"observation": torch.randn(4, 30, 2), "reward": torch.randn(4, 30, 1)}
    return steps.set("next", {**following, "done": flags, "terminated": flags})


BOTH = pytest.mark.parametrize("make", [make_gaussian, make_categorical])


def make_region(loss: TRPOLoss, **given: float) -> TrustRegion:
    given = {"max_kl": 0.01, "damping": 0.1, "iterations": 20, **given}
    return TrustRegion(loss.policy_parameters(), **given)


def evaluate_of(loss: TRPOLoss, batch: TensorDict):
    def evaluate() -> tuple[Tensor, Tensor]:
        terms = loss.policy_terms(batch)
        return terms["loss_objective"], terms["kl"]

    return evaluate


def flat_weights(loss: TRPOLoss) -> Tensor:
    return torch.cat([one.detach().reshape(-1) for one in loss.policy_parameters()])


def dense_step(loss: TRPOLoss, batch: TensorDict, fisher: Tensor) -> Tensor:
    """The natural gradient step of KL 0.01 by a dense solver, with damping 0.1."""
    value, _ = evaluate_of(loss, batch)()
    found = torch.autograd.grad(value, loss.policy_parameters())
    gradient = torch.cat([one.reshape(-1) for one in found])
    damped = fisher + 0.1 * torch.eye(len(fisher))
    direction = torch.linalg.solve(damped, -gradient)
    return direction * (0.02 / (direction @ damped @ direction)).sqrt()


def test_the_step_of_a_gaussian_is_the_natural_gradient() -> None:
    loss, batch = make_gaussian()
    batch = loss.prepare(batch)
    # Of a mean w x + b with deviation s, Fisher's matrix is the mean of (x, 1)(x, 1)'
    # over s^2.
    seen = batch["observation"].reshape(-1, 2)
    seen = torch.cat([seen, torch.ones(len(seen), 1)], -1)
    fisher = seen.T @ seen / len(seen) / DEVIATION**2
    expected, before = dense_step(loss, batch, fisher), flat_weights(loss)
    done = make_region(loss).step(evaluate_of(loss, batch))
    assert done["step"] == 1.0
    moved = flat_weights(loss) - before
    torch.testing.assert_close(moved, expected, rtol=1e-3, atol=1e-5)


def test_the_step_of_a_categorical_is_the_natural_gradient() -> None:
    loss, batch = make_categorical()
    batch = loss.prepare(batch)
    # Of logits, Fisher's matrix is diag(p) - p p'; of the weights A (x, 1), in their
    # order, its Kronecker products with x x'.
    seen = batch["observation"].reshape(-1, 2)
    p = batch["logits"].reshape(-1, 3).softmax(-1)
    inner = torch.diag_embed(p) - p.unsqueeze(-1) * p.unsqueeze(-2)
    eye = torch.eye(3).expand(len(seen), 3, 3)
    weight = torch.einsum("naf,nx->nafx", eye, seen).flatten(2)
    jacobian = torch.cat([weight, eye], -1)
    fisher = (jacobian.mT @ inner @ jacobian).mean(0)
    expected, before = dense_step(loss, batch, fisher), flat_weights(loss)
    done = make_region(loss).step(evaluate_of(loss, batch))
    moved = flat_weights(loss) - before
    torch.testing.assert_close(moved, done["step"] * expected, rtol=1e-3, atol=1e-5)


@BOTH
@pytest.mark.parametrize("max_kl", [1e-3, 1e-2, 0.3])
def test_a_step_keeps_the_bound_and_improves_the_surrogate(make, max_kl: float) -> None:
    loss, batch = make()
    batch = loss.prepare(batch)
    evaluate = evaluate_of(loss, batch)
    before, start = evaluate()
    assert float(start.detach()) == pytest.approx(0, abs=1e-7)
    done = make_region(loss, max_kl=max_kl, damping=1e-3).step(evaluate)
    after, kl = evaluate()
    assert 0 < float(kl.detach()) <= max_kl
    assert after < before
    assert done["loss"] == pytest.approx(float(after))
    assert done["kl"] == pytest.approx(float(kl))
    assert done["loss_before"] == pytest.approx(float(before))


def test_steps_that_are_too_long_are_shortened() -> None:
    weight = nn.Parameter(torch.tensor([1.0]))

    def evaluate() -> tuple[Tensor, Tensor]:
        # Twice as curved as it looks from where it begins, from a little way off.
        away = (weight - 1).square().sum()
        return weight.sum(), 0.5 * away + 1000 * away.square()

    done = TrustRegion([weight], max_kl=0.02, damping=0.0).step(evaluate)
    # 0.2 * 0.8^5 = 0.0655 makes 0.0205; 0.0524 makes 0.0089.
    assert done["step"] == pytest.approx(0.8**6)
    assert float(weight.detach()) == pytest.approx(1 - 0.2 * 0.8**6)


@pytest.mark.parametrize("kind", ["no better", "out of bounds"])
def test_weights_stay_if_no_step_is_allowed(kind: str) -> None:
    weight = nn.Parameter(torch.tensor([1.0, 2.0]))
    start = weight.detach().clone()

    def evaluate() -> tuple[Tensor, Tensor]:
        away = (weight - start).square().sum()
        moved = (weight.detach() != start).any()
        if kind == "no better":
            return weight.sum() + 10 * moved, 0.5 * away
        return weight.sum(), 0.5 * away + 10 * moved

    done = TrustRegion([weight], max_kl=0.01).step(evaluate)
    assert torch.equal(weight, start)
    assert (done["step"], done["kl"], done["loss"]) == (0, 0, done["loss_before"])


@pytest.mark.parametrize("reward", [0.0, torch.nan])
def test_a_gradient_that_is_zero_or_not_finite_moves_nothing(reward: float) -> None:
    loss, batch = make_categorical()
    batch = loss.prepare(batch)
    batch.set("advantage", torch.full_like(batch["advantage"], reward))
    before = flat_weights(loss)
    calls = []

    def evaluate() -> tuple[Tensor, Tensor]:
        calls.append(1)
        return evaluate_of(loss, batch)()

    done = make_region(loss).step(evaluate)
    assert torch.equal(flat_weights(loss), before)
    assert done["step"] == 0
    # No step is tried.
    assert len(calls) == 1


def test_the_curvature_may_be_of_something_else() -> None:
    weight = nn.Parameter(torch.tensor([1.0]))

    def evaluate() -> tuple[Tensor, Tensor]:
        return weight.sum(), 0.5 * (weight - 1).square().sum()

    region = TrustRegion([weight], max_kl=0.02, damping=0.0)
    done = region.step(evaluate, lambda: 4 * evaluate()[1])
    # Four times as curved, half as long: sqrt(2 * 0.02 / 4).
    assert done["step"] == 1
    assert float(weight.detach()) == pytest.approx(0.9)


@pytest.mark.parametrize("given", [False, True])
def test_what_is_differentiated_twice_is_computed_without_cudnn(given: bool) -> None:
    weight, calls = nn.Parameter(torch.tensor([1.0])), []

    def kl() -> Tensor:
        calls.append(torch.backends.cudnn.enabled)
        return 0.5 * (weight - 1).square().sum()

    region = TrustRegion([weight], max_kl=0.02, damping=0.0, backtracks=1)
    region.step(lambda: (weight.sum(), kl()), kl if given else None)
    # Before the step, of the curvature, and after the step.
    assert calls == [True, False, True]
    assert torch.backends.cudnn.enabled


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_recurrent_policy_moves_on_a_gpu() -> None:
    network, batch = collected_slice()
    loss = TRPOLoss(network.cuda())
    batch = loss.prepare(batch.cuda())
    done = make_region(loss).step(evaluate_of(loss, batch))
    assert 0 < done["kl"] <= 0.01


def test_the_divergence_is_from_the_old_policy_to_the_new_one() -> None:
    loss, batch = make_categorical()
    batch = loss.prepare(batch)
    old = batch["logits"].log_softmax(-1)
    with torch.no_grad():
        loss.actor_network[0].module.bias += torch.tensor([2.0, 0, -1])
    new = loss.actor_network(batch.copy())["logits"].log_softmax(-1)
    expected = (old.exp() * (old - new)).sum(-1).mean()
    torch.testing.assert_close(loss.policy_terms(batch)["kl"], expected)


@BOTH
def test_each_part_moves_its_own_weights_alone(make) -> None:
    loss, batch = make()
    batch = loss.prepare(batch)
    loss.critic_loss(loss.critic_inputs(batch)).backward()
    assert all(one.grad is None for one in loss.policy_parameters())
    assert all(one.grad is not None for one in loss.critic_parameters())
    values = loss.critic_network(batch.copy())["state_value"]
    make_region(loss).step(evaluate_of(loss, batch))
    assert torch.equal(loss.critic_network(batch.copy())["state_value"], values)


def test_what_prepare_writes() -> None:
    loss, raw = make_categorical()
    names = set(raw.keys(True, True))
    batch = loss.prepare(raw)
    assert set(raw.keys(True, True)) == names
    assert float(batch["advantage"].mean()) == pytest.approx(0, abs=1e-6)
    assert float(batch["advantage"].std(correction=0)) == pytest.approx(1, abs=1e-5)
    assert not batch["value_target"].requires_grad
    # The old policy is the one of now, whatever acted: the ratio is to that.
    with torch.no_grad():
        loss.actor_network[0].module.bias += torch.tensor([1.0, 0, 0])
    terms = loss.policy_terms(loss.prepare(raw))
    assert float(terms["kl"]) == pytest.approx(0, abs=1e-7)
    ratio = loss.actor_network.get_dist(raw.copy()).log_prob(raw["action"])
    ratio = (ratio - raw["action_log_prob"]).exp().unsqueeze(-1)
    expected = -(ratio * loss.prepare(raw)["advantage"]).mean()
    torch.testing.assert_close(terms["loss_objective"], expected)


def test_its_forward_is_its_parts() -> None:
    loss, raw = make_categorical()
    loss.entropy_coeff.fill_(0.1)
    loss.critic_coeff.fill_(0.5)
    out = loss(raw.select(*loss.in_keys))
    assert set(out.keys()) == set(loss.out_keys)
    torch.testing.assert_close(out["loss_entropy"], -0.1 * out["entropy"])
    batch = loss.prepare(raw, normalize=False)
    values = loss.critic_network(batch.copy())["state_value"]
    expected = 0.5 * (batch["value_target"] - values).square().mean()
    torch.testing.assert_close(out["loss_critic"], expected)


def test_in_keys_are_all_that_a_critic_of_its_own_reads() -> None:
    # One that reads beginnings of episodes needs to know of them afterwards, too.
    loss, raw = make_categorical()
    critic = TensorDictModule(
        lambda observation, is_init: observation[..., :1] + is_init,
        ["observation", "is_init"],
        ["state_value"],
    )
    loss = TRPOLoss(loss.actor_network, critic)
    for side in (raw, raw["next"]):
        side["is_init"] = torch.zeros_like(raw["next", "done"])
    assert (loss(raw.select(*loss.in_keys)) == loss(raw)).all()


def test_a_flat_batch_is_refused() -> None:
    loss, raw = make_categorical()
    message = r"must be \[\*B, T\].* got \[120\]: .*reshape\(-1, T"
    for call in (loss, loss.prepare):
        with pytest.raises(ValueError, match=message):
            call(raw.reshape(-1))
    network, batch = collected_slice()
    loss = TRPOLoss(network)
    message = r"must be \[\*B, T\].* got \[18\]"
    for call in (loss.policy_terms, loss.critic_inputs):
        with pytest.raises(ValueError, match=message):
            call(loss.prepare(batch).reshape(-1))


def test_a_wrong_number_is_refused() -> None:
    weights = [nn.Parameter(torch.zeros(1))]
    with pytest.raises(ValueError, match=r"max_kl must be above 0, got 0"):
        TrustRegion(weights, max_kl=0)
    with pytest.raises(ValueError, match=r"shrink must be above 0 and below 1, got 1"):
        TrustRegion(weights, shrink=1)
    with pytest.raises(
        TypeError, match=r"without a critic_network must be such .*, got L"
    ):
        TRPOLoss(nn.Linear(2, 2))
    with pytest.raises(ValueError, match=r"a ProbabilisticActor of one .* got Linear"):
        TRPOLoss(nn.Linear(2, 2), nn.Linear(2, 1))


@pytest.mark.slow
def test_it_learns_cartpole() -> None:
    """Random play lasts 22 decisions; after 20,480 decisions it lasts over 100."""
    env = make_env(16, categorical=True)
    actor, critic = make_networks(categorical=True)
    loss = TRPOLoss(actor, critic)
    loss.make_value_estimator(gamma=0.99, lmbda=0.95)
    region = TrustRegion(loss.policy_parameters(), max_kl=0.01)
    optimizer = torch.optim.Adam(loss.critic_parameters(), lr=3e-3)
    collector = Collector(env, actor, frames_per_batch=1024, total_frames=20_480)
    for raw in collector:
        batch = loss.prepare(raw)
        assert region.step(evaluate_of(loss, batch))["kl"] <= 0.01
        inputs = loss.critic_inputs(batch).reshape(-1)
        for _ in range(5):
            for rows in torch.randperm(len(inputs)).split(128):
                optimizer.zero_grad()
                loss.critic_loss(inputs[rows]).backward()
                optimizer.step()
    assert mean_return(env, actor) > 100
    collector.shutdown()
