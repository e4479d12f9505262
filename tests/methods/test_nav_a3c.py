"""Nav A3C, and with D2L: its network, its tasks, and who reads the ground truth."""

import copy
import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings, world_of
from toponav import keys
from toponav.config import SettingsError
from toponav.methods import LEARNERS, make_reward
from toponav.methods.learners.nav_a3c_d2l import depth_classes, judge_heads
from toponav.modules import NavActorCritic
from toponav.training import Explorer, make_explore_env, require_explore_room

BOTH = pytest.mark.parametrize("name", ["nav_a3c", "nav_a3c_d2l"])
SMALL = ("reward=extrinsic", "policy.view_size=36", "loss.rollout=10")
ENVS, LENGTH = 4, 10
#: What no policy may read, however it was trained.
TAUGHT = {keys.DEPTH, keys.LOOP_CLOSED}


def unchecked(figures, update: int) -> None:
    pass


def make_learner(name: str, *words: str, seed: int = 0):
    config = explore_settings(*SMALL, f"loss={name}", *words)
    torch.manual_seed(seed)
    return LEARNERS[name](
        config,
        world_of(config),
        reward="reward",
        check=unchecked,
        progress=lambda: 0.0,
    )


def observe(policy: NavActorCritic, length: int, seed: int) -> dict[str, object]:
    """Made-up inputs ``[E, T]`` of a policy."""
    generator = torch.Generator().manual_seed(seed)
    shape = (ENVS, length)
    views = torch.randint(256, (*shape, 36, 36, 3), generator=generator)
    return {
        keys.POLICY_PIXELS: views.to(torch.uint8),
        keys.PREVIOUS_ACTION: torch.randint(7, (*shape, 1), generator=generator),
        keys.PREVIOUS_REWARD: torch.rand(*shape, 1, generator=generator),
        keys.VELOCITY: 20 * torch.randn(*shape, 6, generator=generator),
        "recurrent_state": policy.initial_state(*shape),
    }


def make_batch(policy: NavActorCritic, seed: int = 0) -> TensorDict:
    """A batch as collected: states follow each other, an episode begins at 6."""
    generator = torch.Generator().manual_seed(seed)
    entries = observe(policy, LENGTH, seed)
    is_init = torch.zeros(ENVS, LENGTH, 1, dtype=torch.bool)
    is_init[1:3, 6] = True
    batch = TensorDict({**entries, keys.IS_INIT: is_init}, [ENVS, LENGTH])
    torch.manual_seed(seed)
    steps, state = [], batch[:, 0]["recurrent_state"]
    with torch.no_grad():
        for now in batch.unbind(1):
            steps.append(policy(now.set("recurrent_state", state)))
            state = steps[-1]["next", "recurrent_state"]
    batch = torch.stack(steps, 1)
    shape = (ENVS, LENGTH, 1)
    following = observe(policy, LENGTH, seed + 1)
    following["recurrent_state"] = batch["next", "recurrent_state"]
    following["reward"] = torch.rand(shape, generator=generator)
    following["done"] = following["terminated"] = torch.zeros(shape).bool()
    batch["next"] = TensorDict(following, batch.batch_size)
    batch[keys.DEPTH] = 500 * torch.rand(ENVS, LENGTH, 20, 18, generator=generator)
    batch[keys.LOOP_CLOSED] = torch.rand(shape, generator=generator) > 0.5
    return batch


def test_acting_and_training_see_the_same() -> None:
    policy = make_learner("nav_a3c").policy
    batch = make_batch(policy)
    with torch.no_grad():
        unrolled = policy.unroll(batch)
    for key in (keys.LOGITS, keys.STATE_VALUE):
        torch.testing.assert_close(unrolled[key], batch[key], rtol=1e-4, atol=1e-5)


def test_the_first_layer_feels_the_reward_and_the_second_the_rest() -> None:
    policy = make_learner("nav_a3c", "loss.first_hidden=8").policy
    assert policy.lstm.sizes == [8, 16]
    batch = make_batch(policy)[:, 3]
    known = policy(batch.clone())["next", "recurrent_state", "hidden"]

    def changed(key: str, value: torch.Tensor) -> list[bool]:
        found = policy(batch.clone().set(key, value))
        parts = found["next", "recurrent_state", "hidden"].split([8, 16], -1)
        return [
            not torch.equal(one, old)
            for one, old in zip(parts, known.split([8, 16], -1), strict=True)
        ]

    assert changed(keys.PREVIOUS_REWARD, batch[keys.PREVIOUS_REWARD] + 1) == [True] * 2
    velocity = batch[keys.VELOCITY] + 9
    assert changed(keys.VELOCITY, velocity) == [False, True]
    action = (batch[keys.PREVIOUS_ACTION] + 1) % 7
    assert changed(keys.PREVIOUS_ACTION, action) == [False, True]
    # Map units and degrees come in a world's own measure.
    motion = world_of(explore_settings(*SMALL, "loss=nav_a3c")).spec.motion
    scaled = policy.velocity_scale * torch.tensor([motion.step] * 3 + [motion.turn] * 3)
    torch.testing.assert_close(scaled, torch.ones(6))


@BOTH
def test_learning_changes_all_of_it_and_a_saved_one_continues(name: str) -> None:
    whole, other = make_learner(name), make_learner(name, seed=1)
    before = copy.deepcopy([one.detach() for one in whole.parameters()])
    whole.extend(make_batch(whole.policy).select(*whole.in_keys))
    now = whole.parameters()
    assert not any(torch.equal(*pair) for pair in zip(before, now, strict=True))
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    batch = make_batch(whole.policy, seed=5)
    measured = [one.extend(batch.clone()) for one in (whole, other)]
    assert measured[0] == measured[1]
    assert all(map(torch.equal, whole.parameters(), other.parameters()))


@BOTH
def test_rewards_that_are_not_scaled_may_go_without_discount(name: str) -> None:
    words = ("loss.gamma=1", "loss.normalize_returns=false")
    learner = make_learner(name, *words)
    before = copy.deepcopy([one.detach() for one in learner.parameters()])
    measured = learner.extend(make_batch(learner.policy))
    assert all(map(math.isfinite, measured.values()))
    now = learner.parameters()
    assert not any(torch.equal(*pair) for pair in zip(before, now, strict=True))


def test_the_weights_of_the_tasks_weigh_them() -> None:
    plain = make_learner("nav_a3c_d2l", "loss.depth_coeff=0", "loss.loop_coeff=0")
    heavy = make_learner("nav_a3c_d2l", "loss.depth_coeff=2", "loss.loop_coeff=3")
    batch = plain.scale(make_batch(plain.policy))
    without, found = (one.loss(batch) for one in (plain, heavy))
    assert without["loss_depth"] == without["loss_loop"] == 0
    # Ten decisions of eight, and of two, about equally likely answers.
    assert float(found["loss_depth"]) == pytest.approx(10 * 2 * 2.079, rel=0.05)
    assert float(found["loss_loop"]) == pytest.approx(10 * 3 * 0.693, rel=0.05)
    names = ("loss_objective", "loss_critic", "loss_entropy")
    assert all(float(without[one]) == float(found[one]) for one in names)
    total = sum(found[one] for one in ("loss_depth", "loss_loop"))
    reached = torch.autograd.grad(
        total, list(heavy.policy.parameters()), allow_unused=True
    )
    heads = {id(one) for one in (*heavy.policy.actor.parameters(),)}
    heads |= {id(one) for one in (*heavy.policy.critic.parameters(),)}
    for one, gradient in zip(heavy.policy.parameters(), reached, strict=True):
        assert (gradient is None) == (id(one) in heads)


def test_the_heads_learn_what_they_are_told() -> None:
    words = ("loss.depth_coeff=3.33", "loss.loop_coeff=3", "loss.lr=0.003")
    words += ("loss.eps=1e-5",)
    learner = make_learner("nav_a3c_d2l", *words)
    batch = make_batch(learner.policy)
    # A wall ahead in each decision, at one of four distances, the near ones bright.
    number = torch.randint(4, (ENVS, LENGTH, 1, 1))
    walls = torch.tensor([10.0, 100, 300, 2000])[number]
    batch[keys.DEPTH] = walls.expand(-1, -1, 20, 18)
    views = 60 * (3 - number).unsqueeze(-1)
    batch[keys.POLICY_PIXELS] = views.expand(-1, -1, 36, 36, 3).to(torch.uint8)
    batch[keys.LOOP_CLOSED] = number[..., 0] < 2
    first = learner.extend(batch.clone())
    for _ in range(80):
        last = learner.extend(batch.clone())
    assert first["depth_chance"] == last["depth_chance"] < 0.6
    assert last["depth_accuracy"] > last["depth_chance"] + 0.1
    assert last["loop_found"] > 0.9 > 0.1 > last["loop_false"]


def test_a_batch_in_which_no_loop_closes_is_learned_from() -> None:
    checked: list[str] = []

    def check(figures: Mapping[str, float], update: int) -> None:
        checked.extend(figures)
        assert all(map(math.isfinite, figures.values())), (figures, update)

    learner = make_learner("nav_a3c_d2l")
    learner.check = check
    batch = make_batch(learner.policy)
    batch[keys.LOOP_CLOSED] = torch.zeros(ENVS, LENGTH, 1, dtype=torch.bool)
    measured = learner.extend(batch)
    assert learner.updates == 1
    assert {"loss_loop", "loss_depth", "gradient_norm"} < set(checked)
    assert math.isnan(measured["loop_found"])
    assert measured["loop_share"] == 0


def test_classes_of_depth_by_hand() -> None:
    # Cells of 100: at 100 units 1/2, at 300 units 3/4, at 5 units 1/21.
    depths = torch.tensor([5.0, 100.0, 300.0, 1e6]).reshape(4, 1, 1).expand(4, 20, 18)
    classes = depth_classes(depths, cell_size=100.0)
    assert classes.shape == (4, 64)
    assert classes.unique(dim=1).flatten().tolist() == [0, 4, 6, 7]
    # Of the picture's 20 rows the middle 12 count, of its 18 columns the middle 16.
    picture = torch.full((20, 18), 1e6)
    picture[4:7, 1] = 5.0
    (row,) = (depth_classes(picture, cell_size=100.0) == 0).nonzero()
    assert row.item() == 0
    picture[[0, 3, 16, 19]] = 5.0
    assert int((depth_classes(picture, cell_size=100.0) == 0).sum()) == 1


def test_heads_are_judged_by_hand() -> None:
    classes = torch.tensor([[0, 1], [0, 1], [2, 0], [2, 1]])
    depth = torch.nn.functional.one_hot(torch.zeros(4, 2).long(), 8).float()
    loop = torch.tensor([[1.0], [-1], [1], [-1]])
    closed = torch.tensor([[True], [True], [False], [False]])
    found = judge_heads(depth, classes, loop, closed)
    # Class 0 is right three times in eight; the best of each place 2 + 3 times.
    wanted = {"depth_accuracy": 3 / 8, "depth_chance": 5 / 8, "loop_share": 0.5}
    wanted |= {"loop_found": 0.5, "loop_false": 0.5}
    assert {name: float(one) for name, one in found.items()} == wanted
    none = judge_heads(depth, classes, loop, torch.zeros_like(closed))
    assert none["loop_found"].isnan()


def test_no_policy_reads_what_a_loss_is_taught() -> None:
    for name in LEARNERS:
        learner = make_learner(name) if "nav" in name else None
        config = explore_settings("reward=extrinsic", f"loss={name}")
        policy = LEARNERS[name].make_policy(config, world_of(config))
        read = set(policy.in_keys)
        assert not read & TAUGHT
        assert not any(key[0] == keys.PRIVILEGED for key in read if type(key) is tuple)
        assert (keys.VELOCITY in read) == name.startswith("nav_a3c")
        assert (keys.VELOCITY in read) == ("velocity" in LEARNERS[name].senses)
        taught = name == "nav_a3c_d2l"
        assert bool(LEARNERS[name].taught) == taught
        if learner is not None:
            assert (set(learner.in_keys) >= TAUGHT) == taught


def test_its_actions_are_the_same_whatever_the_truth_says() -> None:
    learner = make_learner("nav_a3c_d2l")
    batch = learner.scale(make_batch(learner.policy))
    other = batch.clone()
    other[keys.DEPTH] = torch.rand_like(other[keys.DEPTH])
    other[keys.LOOP_CLOSED] = ~other[keys.LOOP_CLOSED]
    without = batch.exclude(*TAUGHT)
    actions = []
    for one in (batch, other, without):
        torch.manual_seed(0)
        actions.append(learner.policy(one[:, 3])[keys.ACTION])
    assert torch.equal(actions[0], actions[1])
    assert torch.equal(actions[0], actions[2])
    changed = learner.loss(other)["loss_depth"]
    assert changed != learner.loss(batch)["loss_depth"]


@pytest.mark.parametrize("name", list(LEARNERS))
def test_environments_give_each_learner_what_it_declares(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the truth that is taught only where experience is made, never to judge it."""

    class AskedError(Exception):
        pass

    config = explore_settings("reward=extrinsic", f"loss={name}")
    world, asked = world_of(config), []

    def make_env(*, senses=(), **_: object) -> None:
        asked.append(set(senses))
        raise AskedError

    monkeypatch.setattr(world, "make_env", make_env)
    policy = LEARNERS[name].make_policy(config, world)
    explorer = Explorer(policy, make_reward(config, world, None), None)
    for teach in (True, False):
        with pytest.raises(AskedError):
            make_explore_env(config, world, explorer, envs=2, seed=0, teach=teach)
    velocity = {"velocity"} if name.startswith("nav_a3c") else set()
    depth = {"depth"} if name == "nav_a3c_d2l" else set()
    assert asked == [velocity | depth, velocity]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["loss=nav_a3c", "loss.first_hidden=0"], "loss.first_hidden must be at least"),
        (["loss=nav_a3c_d2l", "loss.near=2"], "loss.far must be more than loss.near=2"),
        (["loss=nav_a3c_d2l", "loss.depth_coeff=-1"], "loss.depth_coeff must be at le"),
    ],
)
def test_settings_out_of_range_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        explore_settings(*SMALL, *words)


@BOTH
def test_worlds_without_a_velocity_and_embeddings_are_refused(
    name: str, tmp_path: Path
) -> None:
    config = explore_settings(*SMALL, f"loss={name}")
    world = world_of(config)
    world.senses = ()
    wanted = "velocity" if name == "nav_a3c" else "velocity and depth"
    rule = f"loss={name} must have a world that gives {wanted}, got maze3 without"
    with pytest.raises(SettingsError, match=rule):
        LEARNERS[name](
            config, world, reward="reward", check=unchecked, progress=lambda: 0.0
        )
    world.spec = dataclasses.replace(world.spec, motion=None)
    with pytest.raises(SettingsError, match=rule):
        require_explore_room(config, world, tmp_path)
    embedded = explore_settings(f"loss={name}")
    with pytest.raises(SettingsError, match="pixels with loss=nav_a3c"):
        LEARNERS[name].make_policy(embedded, world_of(embedded))


@BOTH
def test_more_layers_are_refused(name: str) -> None:
    deep = explore_settings(*SMALL, f"loss={name}", "policy.layers=2")
    with pytest.raises(
        SettingsError, match=f"layers must be 1 with loss={name}, got 2"
    ):
        LEARNERS[name].make_policy(deep, world_of(deep))
    with pytest.raises(ValueError, match="layers must be 1, got 2"):
        NavActorCritic(step=33.0, turn=20.0, num_actions=6, layers=2)
