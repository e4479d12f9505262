"""DQN and DRQN as learners of an exploration."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import set_recurrent_mode
from torchrl.objectives import dqn
from torchrl.objectives.utils import distance_loss

from tests.exploring import explore_settings, world_of
from tests.fakes import FakeMaze
from toponav.config import SettingsError, TrainingError
from toponav.keys import ACTION_VALUE, FRAMES, IS_INIT, POLICY_PIXELS
from toponav.methods import LEARNERS
from toponav.methods.learners.q_learner import QLearner
from toponav.transforms import PolicyPixels

BOTH = pytest.mark.parametrize("name", ["dqn", "drqn"])
SIZE = (36, 36)
#: A few decisions of small views.
SMALL = ("reward=extrinsic", "maze.goal=true", "policy.view_size=36")
SMALL += ("loss.replay=512", "loss.warmup=0", "loss.rollout=20", "loss.batch=8")


def unchecked(figures, update: int) -> None:
    pass


def make_learner(
    name: str, *words: str, seed: int = 0, progress: float = 0.0, check=unchecked
) -> QLearner:
    config = explore_settings(*SMALL, f"loss={name}", *words)
    torch.manual_seed(seed)
    learner = LEARNERS[name](
        config,
        world_of(config),
        reward="reward",
        check=check,
        progress=lambda: progress,
    )
    assert isinstance(learner, QLearner)
    return learner


def make_env(learner: QLearner, *, envs: int = 2, longest: int = 7) -> EnvBase:
    maze = FakeMaze(batch_size=(envs,), max_decisions=longest, image_size=SIZE)
    primer = learner.policy.make_tensordict_primer()
    return TransformedEnv(maze, Compose(PolicyPixels(SIZE), InitTracker(), primer))


def make_batch(*, seed: int = 0, envs: int = 4, length: int = 20) -> TensorDict:
    """Made-up decisions: action 0 pays where the view is bright, action 1 elsewhere."""
    generator = torch.Generator().manual_seed(seed)
    bright = torch.randint(2, (envs, length + 1), generator=generator)
    views = (200 * bright).reshape(envs, length + 1, 1, 1, 1).expand(-1, -1, *SIZE, 3)
    views = views.to(torch.uint8)
    action = torch.randint(6, (envs, length), generator=generator)
    right = action == 1 - bright[:, :-1]
    every = torch.ones(envs, length, 1, dtype=torch.bool)
    following = {
        POLICY_PIXELS: views[:, 1:],
        "reward": right.float().unsqueeze(-1),
        "done": every,
        "terminated": every,
    }
    now = {POLICY_PIXELS: views[:, :-1], "action": action, IS_INIT: every}
    return TensorDict({**now, "next": following}, [envs, length])


def values(learner: QLearner, batch: TensorDict) -> torch.Tensor:
    with torch.no_grad():
        return learner.policy.value_network(batch.copy())[ACTION_VALUE]


@BOTH
def test_replayed_slices_say_what_the_policy_saw(name: str) -> None:
    """The stack and the memory of a slice are those with which the agent acted."""
    torch.manual_seed(0)
    word = "loss.frames=4" if name == "dqn" else "loss.unroll=20"
    learner = make_learner(name, word, "loss.epsilon=1.0")
    env = make_env(learner)
    steps = env.rollout(20, learner.policy, break_when_any_done=False)
    learner.replay.extend(steps.exclude(FRAMES))
    slices = learner.replay.sample(200)
    batch = learner.make_batch(slices)
    if name == "drqn":
        # The slice is the whole of a row, from an empty memory through three episodes.
        with set_recurrent_mode(True), torch.no_grad():
            found = learner.policy.value_network(batch[:1].copy())[ACTION_VALUE]
        known = steps[ACTION_VALUE]
        away = (known.detach() - found).abs().amax((1, 2))
        assert float(away.min()) < 1e-5
        return
    # Views that were seen in the rollout, by their stacks.
    seen = {bytes(one.numpy()) for one in _stacks(steps).reshape(-1, *SIZE, 12)}
    drawn = {bytes(one.numpy()) for one in _stacks(batch)}
    assert len(drawn) > 10
    # A stack of a slice is whole only if the slice has what was before it.
    assert drawn <= seen
    going = ~batch["next", "done"].squeeze(-1)
    later = {bytes(one.numpy()) for one in _stacks(batch["next"])[going]}
    after = _stacks(steps["next"]).reshape(-1, *SIZE, 12)
    assert later <= {bytes(one.numpy()) for one in after}


def _stacks(data: TensorDict) -> torch.Tensor:
    return torch.cat([data[FRAMES], data[POLICY_PIXELS]], -1)


def test_a_stack_is_black_before_an_episode() -> None:
    learner = make_learner("dqn")
    views = torch.arange(1, 6).reshape(1, 5, 1, 1, 1).expand(1, 5, *SIZE, 3).byte()
    none = torch.zeros(1, 4, 1, dtype=torch.bool)
    is_init = none.clone()
    is_init[:, 2] = True
    following = {POLICY_PIXELS: views[:, 1:], "reward": none.float(), "done": none}
    slices = TensorDict(
        {
            POLICY_PIXELS: views[:, :-1],
            "action": none.squeeze(-1).long(),
            IS_INIT: is_init,
            "next": {**following, "terminated": none},
            "collector": {"mask": ~none},
        },
        [1, 4],
    )
    batch = learner.make_batch(slices)
    assert batch[FRAMES][0, 0, 0].tolist() == [0, 0, 0] * 2 + [3, 3, 3]
    assert batch[POLICY_PIXELS].unique().tolist() == [4]
    later = batch["next"]
    assert later[FRAMES][0, 0, 0].tolist() == [0, 0, 0, 3, 3, 3, 4, 4, 4]
    assert later[POLICY_PIXELS].unique().tolist() == [5]


@BOTH
def test_the_target_is_the_scaled_reward_and_what_follows(name: str) -> None:
    batch = make_batch()
    batch["next", "reward"] = torch.full_like(batch["next", "reward"], 10.0)
    for ends in (False, True):
        learner = make_learner(name, "loss.gamma=0.5", "loss.reward_scale=0.1")
        *weights, bias = learner.policy.parameters()
        for parameter in weights:
            torch.nn.init.zeros_(parameter)
        # Every action is worth 0.4, for the target network as well.
        torch.nn.init.constant_(bias, 0.4)
        learner.target.step()
        flags = torch.full((4, 20, 1), ends)
        batch[IS_INIT] = batch["next", "done"] = batch["next", "terminated"] = flags
        learner.replay.extend(batch)
        # 1 + 0.5 * 0.4 - 0.4 = 0.8, or 1 - 0.4 = 0.6: smooth L1 halves the square.
        assert learner._step() == pytest.approx(0.5 * (0.6 if ends else 0.8) ** 2)


@BOTH
def test_nothing_is_learned_of_what_follows(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The memory that the older copy begins with is no way back to the weights."""
    learner, seen = make_learner(name), []

    def note(value: torch.Tensor, target: torch.Tensor, *rest: str) -> torch.Tensor:
        seen.append((value.requires_grad, target.requires_grad))
        return distance_loss(value, target, *rest)

    monkeypatch.setattr(dqn, "distance_loss", note)
    batch = make_batch()
    flags = torch.zeros(4, 20, 1, dtype=torch.bool)
    batch[IS_INIT] = batch["next", "done"] = batch["next", "terminated"] = flags
    learner.replay.extend(batch)
    learner._step()
    assert seen == [(True, False)]


def test_what_follows_is_judged_by_the_views_of_the_slice_and_its_episode() -> None:
    learner = make_learner("drqn", "loss.gamma=1", "loss.unroll=6")
    none = torch.zeros(1, 6, 1, dtype=torch.bool)
    torch.manual_seed(0)
    views = torch.randint(256, (1, 7, *SIZE, 3), dtype=torch.uint8)
    # An episode of three decisions, and the first three of another one.
    starts = torch.tensor([0, 0, 0, 1, 0, 0, 0]).bool().reshape(1, 7, 1)
    seen = []

    def following(views: torch.Tensor) -> list[float]:
        now = {POLICY_PIXELS: views[:, :-1], IS_INIT: starts[:, :-1]}
        later = {POLICY_PIXELS: views[:, 1:], IS_INIT: starts[:, 1:]}
        batch = TensorDict({**now, "action": none[..., 0].long()}, [1, 6])
        later |= {"reward": none.float(), "done": none, "terminated": none}
        batch["next"] = TensorDict(later, [1, 6])
        batch["collector", "mask"] = ~none
        learner.compute_loss(batch)
        return seen.pop().flatten().tolist()

    def note(value: torch.Tensor, target: torch.Tensor, *rest: str) -> torch.Tensor:
        seen.append(target)
        return distance_loss(value, target, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dqn, "distance_loss", note)
        found = following(views)
        for changed, alone in ((0, range(2)), (1, range(2)), (3, range(2, 6))):
            other = views.clone()
            other[:, changed] = 255 - other[:, changed]
            moved = [
                one != two for one, two in zip(found, following(other), strict=True)
            ]
            # Of its own episode what comes with it or later, of the other one nothing:
            # the view after decision 2 is the first one of the second episode.
            assert moved == [row in alone and row >= changed - 1 for row in range(6)], (
                changed
            )


@pytest.mark.slow
@BOTH
def test_it_learns_which_action_pays(name: str) -> None:
    words = ("loss.lr=0.001", "loss.every=2", "loss.epsilon_until=1")
    learner = make_learner(name, *words, "loss.target_every=20", progress=0.5)
    for seed in range(3):
        measured = learner.extend(make_batch(seed=seed))
    assert learner.updates == 3 * 80 // 2
    assert measured["epsilon"] == pytest.approx(0.55)
    test = make_batch(seed=9, envs=8, length=20)
    entries = {POLICY_PIXELS: test[POLICY_PIXELS], IS_INIT: test[IS_INIT]}
    primer = learner.policy.make_tensordict_primer()
    for key, spec in primer.primers.items(True, True):
        entries[key] = spec.zero((8, 20))
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = learner.policy(TensorDict(entries, [8, 20]))["action"]
    right = test[POLICY_PIXELS][:, :, 0, 0, 0] > 0
    assert float((action == (~right).long()).float().mean()) > 0.95


@BOTH
def test_a_larger_eps_makes_steps_small(name: str) -> None:
    moved = []
    for eps in (1e-8, 1.0):
        learner = make_learner(name, "loss.lr=0.001", f"loss.eps={eps}")
        learner.replay.extend(make_batch())
        before = [weight.clone() for weight in learner.policy.parameters()]
        learner._step()
        after = zip(before, learner.policy.parameters(), strict=True)
        moved.append(max(float((now - old).abs().max()) for old, now in after))
    # Adam's first step is lr x g / (|g| + eps) for a gradient g, of norm 10 at most.
    assert moved[0] == pytest.approx(0.001, rel=0.01)
    assert moved[1] < 0.001 * 10 / 11


@BOTH
def test_one_that_was_saved_goes_on_with_a_replay_of_its_own(name: str) -> None:
    words = ("loss.target_every=3", "loss.every=16")
    whole, other = make_learner(name, *words), make_learner(name, *words, seed=1)
    whole.extend(make_batch())
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    other.replay = whole.replay
    measured = []
    for learner in (whole, other):
        torch.manual_seed(0)
        measured.append([learner._step() for _ in range(4)])
    assert measured[0] == measured[1]
    assert whole.updates == other.updates == 9
    states = [one.loss.state_dict() for one in (whole, other)]
    assert all(torch.equal(one, states[1][name]) for name, one in states[0].items())
    # The target network is that of the ninth update, and no older one.
    for now, old in zip(
        whole.loss.value_network_params.parameters(),
        whole.loss.target_value_network_params.values(True, True),
        strict=True,
    ):
        assert torch.equal(now, old)


@BOTH
def test_a_trained_policy_is_nearly_greedy(name: str) -> None:
    learner = make_learner(name, "loss.test_epsilon=0.25")
    assert float(learner.policy.epsilon) == 1
    learner.settle(learner.policy)
    assert float(learner.policy.epsilon) == 0.25
    # It goes with the weights: collecting processes have no other clock.
    other = make_learner(name, seed=1).policy
    other.load_state_dict(learner.policy.state_dict())
    assert float(other.epsilon) == 0.25


def test_nothing_is_learned_before_there_is_enough() -> None:
    learner = make_learner("dqn", "loss.warmup=100")
    before = [one.clone() for one in learner.policy.parameters()]
    measured = learner.extend(make_batch())
    assert math.isnan(measured["loss_value"])
    assert learner.updates == 0
    assert all(map(torch.equal, before, learner.policy.parameters()))
    learner.extend(make_batch(seed=1))
    assert learner.updates == 80 // 4


@BOTH
def test_a_loss_that_is_not_finite_stops_before_the_weights_change(name: str) -> None:
    def check(figures, update: int) -> None:
        if any(value != value for value in figures.values()):
            raise TrainingError(f"{sorted(figures)} in {update}")

    learner = make_learner(name, check=check)
    before = [one.clone() for one in learner.policy.parameters()]
    batch = make_batch()
    batch["next", "reward"] = torch.full_like(batch["next", "reward"], torch.nan)
    with pytest.raises(TrainingError, match="loss_value"):
        learner.extend(batch)
    assert all(map(torch.equal, before, learner.policy.parameters()))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["loss=dqn", "loss.frames=21"], "loss.rollout must be at least loss.frames"),
        (["loss=drqn", "loss.unroll=30"], "at least loss.unroll=30, got 20"),
        (["loss=dqn", "loss.replay=79"], r"collect.envs \* loss.rollout = 80, got 79"),
        (["loss=dqn", "loss.warmup=513"], "loss.warmup must be at most 500, the"),
        (["loss=drqn", "loss.epsilon=2"], r"loss.epsilon must lie in \[0, 1\], got 2"),
        (["loss=drqn", "loss.every=0"], "loss.every must be at least 1, got 0"),
    ],
)
def test_settings_out_of_range_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        explore_settings(*SMALL, *words)


@pytest.mark.parametrize("loss", ["dqn", "drqn"])
def test_more_layers_are_refused(loss: str) -> None:
    config = explore_settings(f"loss={loss}", "policy.input=pixels", "policy.layers=2")
    with pytest.raises(
        SettingsError, match=rf"layers must be 1 with loss={loss}, got 2"
    ):
        LEARNERS[loss].make_policy(config, world_of(config))


def test_embeddings_are_refused() -> None:
    config = explore_settings("loss=dqn")
    with pytest.raises(SettingsError, match=r"policy.input must be pixels with loss=d"):
        LEARNERS["dqn"].make_policy(config, world_of(config))
