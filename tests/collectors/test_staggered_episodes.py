import pytest
import torch
from torchrl.envs import SerialEnv, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.fakes import FakeMaze
from toponav.collectors import StaggeredEpisodes

LENGTH = 12


def make_env(num_envs: int = 4, length: int = LENGTH) -> TransformedEnv:
    env = FakeMaze(batch_size=(num_envs,), max_decisions=LENGTH)
    return TransformedEnv(TransformedEnv(env, StaggeredEpisodes(length)), StepCounter())


def ends(env: TransformedEnv, decisions: int) -> list[list[int]]:
    """The decisions at which each row's episodes ended."""
    rollout = env.rollout(decisions, break_when_any_done=False)
    done = rollout["next", "done"].squeeze(-1)
    assert torch.equal(done, rollout["next", "truncated"].squeeze(-1))
    return [(row.nonzero().flatten() + 1).tolist() for row in done]


def test_first_episodes_end_one_after_the_other_and_later_ones_are_whole() -> None:
    # Row e of 4 is cut after 12 (e + 1) / 4 = 3, 6, 9, 12 decisions.
    assert ends(make_env(), 33) == [[3, 15, 27], [6, 18, 30], [9, 21, 33], [12, 24]]


def test_more_rows_than_decisions_round_up() -> None:
    # ceil(2 / 5), ceil(4 / 5), ceil(6 / 5), ceil(8 / 5), ceil(10 / 5)
    assert ends(make_env(5, length=2), 2) == [[1], [1], [2], [2], [2]]


def test_an_episode_that_ends_by_itself_needs_no_cut() -> None:
    # The rows would be cut after 10 and 20, but the maze ends the second at 12.
    assert ends(make_env(2, length=20), 30) == [[10, 22], [12, 24]]


def test_a_reset_of_all_starts_from_the_beginning() -> None:
    env = make_env(2)
    assert ends(env, 20) == [[6, 18], [12]]
    assert ends(env, 20) == [[6, 18], [12]]


@pytest.mark.parametrize("num_envs", [1, 3])
def test_specs_hold(num_envs: int) -> None:
    check_env_specs(make_env(num_envs), break_when_any_done="both")


def test_it_works_inside_and_around_a_serial_env() -> None:
    def one() -> TransformedEnv:
        maze = FakeMaze(max_decisions=LENGTH)
        return TransformedEnv(maze, StaggeredEpisodes(5))

    check_env_specs(SerialEnv(2, one), break_when_any_done="both")
    around = TransformedEnv(
        SerialEnv(2, lambda: FakeMaze(max_decisions=LENGTH)), StaggeredEpisodes(6)
    )
    assert ends(around, 14) == [[3], [6]]


def test_a_length_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="length must be at least 1, got 0"):
        StaggeredEpisodes(0)
