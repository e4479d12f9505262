"""What other projects hand in: flat batches, actions and views of other kinds.

Each part takes it, with the result of what it usually gets, or refuses it in words.
"""

from functools import partial
from math import log, pi

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.nn.functional import one_hot
from torchrl.data import (
    Binary,
    Bounded,
    Categorical,
    MultiCategorical,
    MultiOneHot,
    OneHot,
    TensorSpec,
)
from torchrl.data.postprocs import MultiStep
from torchrl.envs import GymEnv, TransformedEnv
from torchrl.envs.utils import ExplorationType
from torchrl.modules import (
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
    ValueOperator,
)

from tests.fakes import FakeMaze
from tests.graph.grey_world import episode, make_map
from tests.objectives.slices import collected_slice
from tests.objectives.test_missing_entries import BATCHES
from tests.refused import refused
from tests.transforms.test_missing_entries import TRANSFORMS
from toponav import keys, objectives, transforms
from toponav.modules import ActorCritic

#: Those that learn from rewards, and those that learn from pairs of views.
OF_SLICES = ("A3CLoss", "TRPOLoss", "RecurrentPPOLoss")
OF_PAIRS = ("TCLoss", "LLoss")
#: Those that also take an actor and a critic of one's own.
OF_ANY_ACTOR = pytest.mark.parametrize(
    "kind", [objectives.A3CLoss, objectives.TRPOLoss]
)


def test_every_loss_is_one_of_them() -> None:
    assert {*OF_SLICES, *OF_PAIRS} == set(BATCHES)


# --- batches -----------------------------------------------------------------
@pytest.mark.parametrize("name", OF_SLICES)
def test_a_loss_of_slices_says_how_a_flat_batch_becomes_one(name: str) -> None:
    loss, batch = BATCHES[name]()
    flat = batch.reshape(-1)
    assert "batch.reshape(-1, T)" in refused(lambda: loss(flat))
    wanted = loss(batch.copy())
    found = loss(flat.reshape(-1, 3))  # its rows are slices of three decisions
    assert bool((wanted == found).all())


@pytest.mark.parametrize("name", OF_SLICES)
def test_a_loss_of_slices_refuses_several_decisions_at_once(name: str) -> None:
    loss, batch = BATCHES[name]()
    said = refused(lambda: loss(MultiStep(gamma=0.9, n_steps=2)(batch)))
    assert "one decision later, got 2 in 'steps_to_next_obs'" in said
    # Which one at once are not.
    wanted, found = loss(batch.copy()), loss(MultiStep(gamma=0.9, n_steps=1)(batch))
    assert bool((wanted == found).all())


def test_trpo_takes_a_flat_batch_of_feed_forward_networks_with_advantages() -> None:
    actor, critic, batch = make_continuous(IndependentNormal)
    loss = objectives.TRPOLoss(actor, critic)
    batch = loss.prepare(batch)
    torch.testing.assert_close(loss(batch.reshape(-1)), loss(batch))


def test_the_scale_of_returns_says_so_too() -> None:
    _, batch = collected_slice(rows=2, steps=3)
    scale = partial(objectives.ReturnScale, 2, reward="reward")
    said = refused(lambda: scale()(batch.reshape(-1)))
    assert "batch.reshape(E, -1)" in said
    wanted = scale()(batch.copy())["next", "scaled_reward"]
    found = scale()(batch.reshape(-1).reshape(2, -1))["next", "scaled_reward"]
    assert torch.equal(wanted, found)
    flat = batch.copy()
    flat["next", "reward"] = flat["next", "reward"].squeeze(-1)
    assert "[2, 3, 1], got [2, 3]" in refused(lambda: scale()(flat))


@pytest.mark.parametrize("name", OF_PAIRS)
def test_a_loss_of_pairs_takes_any_batch(name: str) -> None:
    loss, pairs = BATCHES[name]()
    wanted, found = loss(pairs), loss(pairs.reshape(2, 2))
    for key in loss.out_keys:
        torch.testing.assert_close(found[key], wanted[key])


#: What the transforms read that need no steps.
ENTRIES = {
    "pixels": torch.randint(256, (2, 3, 8, 8, 3), dtype=torch.uint8),
    "network_pixels": torch.randint(256, (2, 3, 4, 4, 3), dtype=torch.uint8),
    "visits": torch.tensor([[[1], [2], [0]], [[3], [0], [0]]]),
    "is_new_waypoint": torch.tensor([[[0], [0], [1]], [[0], [1], [0]]]).bool(),
    "similarity": torch.rand(2, 3, 1),
    "count_reward": torch.rand(2, 3, 1),
    "temporal_distance_reward": torch.rand(2, 3, 1),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_transform_takes_a_flat_batch_or_needs_steps(name: str) -> None:
    batch = TensorDict(ENTRIES, [2, 3])
    transform = TRANSFORMS[name]()
    try:
        wanted = transform(batch.copy())
    except NotImplementedError:
        said = refused(lambda: transform(batch.reshape(-1)))
        assert f"{name} must be in a TransformedEnv" in said
        return
    found = TRANSFORMS[name]()(batch.reshape(-1))
    for key in transform.out_keys:
        assert torch.equal(found[key], wanted[key].flatten(0, 1)), key


def test_a_map_takes_a_flat_batch_where_episodes_can_be_told_apart() -> None:
    one, other = episode(0, 30), episode(60, 90)
    apart = make_map()
    apart.add_episode(one)
    apart.add_episode(other)
    assert apart.edges.tolist() == [[0, 1], [2, 3]]
    flat = torch.cat([one, other])
    # By the flag at the end of each, or by the collector's numbers without flags.
    together = make_map()
    assert together.add_episode(flat).tolist() == [0, 1, 2, 3]
    assert together.edges.tolist() == apart.edges.tolist()
    numbered = make_map()
    flat[keys.TRAJECTORY] = torch.tensor([7, 7, 9, 9])
    numbered.add_episode(flat.exclude("next"))
    assert numbered.edges.tolist() == apart.edges.tolist()
    said = refused(lambda: make_map().extend(flat))
    assert (
        "[E, T >= 1], got [4]: rows that lie one after the other are batch.re" in said
    )


# --- value estimators --------------------------------------------------------
@pytest.mark.parametrize("name", OF_SLICES)
def test_a_gamma_of_zero_leaves_the_reward_to_every_loss(name: str) -> None:
    loss, batch = BATCHES[name]()
    loss.make_value_estimator(gamma=0)
    make_target = {"TRPOLoss": "prepare", "RecurrentPPOLoss": "estimate_advantage"}
    if name in make_target:
        target = getattr(loss, make_target[name])(batch.copy())["value_target"]
        torch.testing.assert_close(target, batch["next", "reward"])
    # 0.5 (r - V)^2 in the mean, of TRPO (r - V)^2.
    error = (batch["next", "reward"] - batch["state_value"]).square().mean()
    weight = 1.0 if name == "TRPOLoss" else 0.5
    # A3C sums over the slice.
    weight *= batch.shape[1] if name == "A3CLoss" else 1
    torch.testing.assert_close(loss(batch)["loss_critic"].mean(), weight * error)


@pytest.mark.parametrize("name", OF_PAIRS)
def test_a_loss_of_pairs_refuses_a_value_estimator(name: str) -> None:
    loss, _ = BATCHES[name]()
    said = refused(lambda: loss.make_value_estimator(gamma=0))
    assert f"{name} must go without a value estimator" in said
    assert "'gamma': 0" in said


# --- actions -----------------------------------------------------------------
@pytest.mark.parametrize("name", [*OF_SLICES, "LLoss"])
def test_a_loss_takes_one_hot_actions(name: str) -> None:
    loss, batch = BATCHES[name]()
    number = 4 if name == "LLoss" else loss_actions(loss)
    wanted = loss(batch.copy())
    for kind in (torch.int64, torch.bool):
        hot = one_hot(batch["action"], number).to(kind)
        assert bool((loss(batch.copy().set("action", hot)) == wanted).all())
    floats = batch.copy().set("action", one_hot(batch["action"], number).float())
    assert "integers or bools, got torch.float32" in refused(lambda: loss(floats))


def loss_actions(loss: torch.nn.Module) -> int:
    network = getattr(loss, "actor_critic", None) or loss.actor_network
    return int(network.num_actions)


def make_continuous(
    kind: type, rows: int = 2, number: int = 2
) -> tuple[ProbabilisticActor, ValueOperator, TensorDict]:
    """A policy of a normal distribution over ``number`` numbers, and its decisions."""
    torch.manual_seed(0)
    body = torch.nn.Sequential(torch.nn.Linear(3, 2 * number), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(body, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=kind,
        default_interaction_type=ExplorationType.RANDOM,
        return_log_prob=True,
    )
    views, after = torch.randn(2, rows, 5, 3)
    never = torch.zeros(rows, 5, 1, dtype=torch.bool)
    following = {"observation": after, "reward": torch.randn(rows, 5, 1)}
    following |= {"done": never, "terminated": never}
    batch = TensorDict({"observation": views, "next": following}, [rows, 5])
    critic = ValueOperator(torch.nn.Linear(3, 1), in_keys=["observation"])
    return actor, critic, actor(batch).detach()


@OF_ANY_ACTOR
def test_a_loss_of_one_s_own_actor_takes_continuous_actions(kind: type) -> None:
    actor, critic, batch = make_continuous(IndependentNormal)
    loss = kind(actor, critic)
    batch["advantage"] = batch["value_target"] = torch.ones(2, 5, 1)
    batch["action_log_prob"] = torch.zeros(2, 5)
    away = (batch["action"] - batch["loc"]) / batch["scale"]
    each = -0.5 * away.square() - batch["scale"].log() - 0.5 * log(2 * pi)
    # A3C's is the logarithm, summed over the slice, TRPO's the ratio, in the mean.
    log_prob = each.sum(-1)
    wanted = log_prob.sum(-1) if kind is objectives.A3CLoss else log_prob.exp()
    out = loss(batch)
    torch.testing.assert_close(out["loss_objective"], -wanted.mean())
    out["loss_objective"].backward()
    assert all(one.grad.any() for one in actor.parameters())


@OF_ANY_ACTOR
def test_a_log_probability_of_each_number_is_refused(kind: type) -> None:
    actor, critic, batch = make_continuous(torch.distributions.Normal, 1, 1)
    said = refused(lambda: kind(actor, critic)(batch))
    assert "shape [1, 5], one a decision, got [1, 5, 1] of Normal" in said
    assert "IndependentNormal" in said


def maze_of(spec: TensorSpec) -> FakeMaze:
    env = FakeMaze()
    env.action_spec = spec
    return env


#: Actions that are not one choice of several.
OTHERS = [
    MultiCategorical((2, 3)),
    MultiOneHot((2, 3)),
    Binary(4),
    Bounded(-1.0, 1.0, (2,)),
]


@pytest.mark.parametrize("spec", OTHERS, ids=lambda spec: type(spec).__name__)
@pytest.mark.parametrize(
    "make",
    [
        lambda: transforms.PreviousAction(4),
        lambda: ActorCritic(num_actions=4, embedding_dim=3).make_tensordict_primer(),
    ],
    ids=["PreviousAction", "ActorCritic"],
)
def test_other_actions_are_refused(make, spec: TensorSpec) -> None:
    said = refused(lambda: TransformedEnv(maze_of(spec), make()).reset())
    assert "'action' must be one choice of several" in said
    assert type(spec).__name__ in said


def test_a_policy_refuses_actions_of_another_shape() -> None:
    primer = ActorCritic(num_actions=4, embedding_dim=3).make_tensordict_primer
    for spec in (Categorical(4, shape=(1,)), OneHot(4)):
        said = refused(
            lambda spec=spec: TransformedEnv(maze_of(spec), primer()).reset()
        )
        assert "the env's actions" in said
    TransformedEnv(maze_of(Categorical(4)), primer()).reset()


@pytest.mark.parametrize(
    "name", [name for name in dir(transforms) if name in TRANSFORMS]
)
def test_a_transform_in_an_env_that_lacks_all_it_reads_says_so(name: str) -> None:
    env = TransformedEnv(GymEnv("CartPole-v1"), TRANSFORMS[name]())
    said = refused(lambda: env.rollout(2))
    # Its actions are there, but two and not four.
    missing = "num_actions" if name == "PreviousAction" else "must"
    assert missing in said


def test_what_a_loss_lacks_under_next_is_looked_for_there() -> None:
    loss, batch = BATCHES["A3CLoss"]()
    said = refused(lambda: loss(batch.exclude(("next", "reward"))))
    assert "got [\"('next', 'done')\"" in said
    _, batch = collected_slice(rows=2, steps=3)
    said = refused(lambda: objectives.ReturnScale(2)(batch))
    assert "named by ReturnScale(reward=...)" in said
    assert "('next', 'reward')" in said
