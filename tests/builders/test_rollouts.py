import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import StepCounter, TransformedEnv
from torchrl.envs.utils import ExplorationType, exploration_type

from tests.fakes import FakeMaze
from toponav.builders import collect_rollout
from toponav.keys import ACTION, PIXELS, POSITION


class Turner(TensorDictModuleBase):
    """Turns left; counts its decisions and notes how actions are to be chosen."""

    in_keys = [PIXELS]
    out_keys = [ACTION]

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[ExplorationType | None] = []

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.asked.append(exploration_type())
        action = torch.full(tensordict.batch_size, 2)
        return tensordict.set(ACTION, action)


def make_env() -> TransformedEnv:
    return TransformedEnv(FakeMaze(batch_size=[3], max_decisions=4), StepCounter())


def test_it_keeps_the_keys_that_are_asked_for_and_no_others() -> None:
    rollout = collect_rollout(
        make_env(), Turner(), 5, keep=[POSITION, "gone"], keep_next=["done"]
    )
    assert rollout.frames.shape == (3, 5)
    keys = rollout.frames.keys(include_nested=True, leaves_only=True)
    assert set(keys) == {POSITION, ("next", "done")}
    assert len(rollout.views) == 0


def test_an_episode_that_ends_is_followed_by_the_next() -> None:
    rollout = collect_rollout(
        make_env(), Turner(), 6, keep=["step_count"], keep_next=["done"]
    )
    assert rollout.frames["step_count"][0].flatten().tolist() == [0, 1, 2, 3, 0, 1]
    done = rollout.frames["next", "done"][0].flatten().tolist()
    assert done == [False, False, False, True, False, False]


def test_the_views_of_the_first_environment_begin_with_its_reset() -> None:
    def play(views: int):
        env = make_env()
        env.set_seed(1)
        return collect_rollout(
            env, Turner(), 3, keep=[PIXELS], keep_next=[PIXELS], views=views
        )

    rollout = play(9)
    expected = [*rollout.frames[PIXELS][0], rollout.frames["next", PIXELS][0, -1]]
    assert torch.equal(rollout.views, torch.stack(expected))
    assert torch.equal(rollout.start[PIXELS], rollout.views[0])
    assert torch.equal(play(2).views, rollout.views[:2])


def test_actions_are_sampled_and_progress_is_counted_in_decisions() -> None:
    policy, counts = Turner(), []
    collect_rollout(make_env(), policy, 2, keep=[], progress=counts.append)
    assert policy.asked == [ExplorationType.RANDOM] * 2
    assert counts == [3, 3]
