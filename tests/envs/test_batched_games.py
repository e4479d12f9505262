"""Many mazes in lock step: same seed, same episodes; a loss is one row's own."""

import hashlib
import os
import signal
import threading
import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import psutil
import pytest

from tests.envs.children import run
from tests.envs.layouts import GATE
from toponav.envs import EngineError, load_maze
from toponav.envs.batched_games import BatchedGames
from toponav.envs.engines import load_engine
from toponav.envs.engines.doom.game import MazeGame
from toponav.envs.scene import SceneRules

RULES = SceneRules(apples=3, goal=True, blocked=("a",))
MAZE1 = load_maze("maze1")
VIZDOOM = load_engine("vizdoom")


def make(size: int, **options) -> BatchedGames:
    settings = {"rules": RULES, "episode_length": 12, **options}
    return BatchedGames(VIZDOOM, MAZE1, size, **settings)


@pytest.fixture(scope="module")
def four() -> Iterator[BatchedGames]:
    games = make(4)
    yield games
    games.close()


@pytest.fixture(scope="module")
def two() -> Iterator[BatchedGames]:
    games = make(2)
    yield games
    games.close()


def digests(games: BatchedGames, *, actions: int = 0, episodes: int = 2) -> list[str]:
    """For each row, a hash of pixels, rewards and poses of its next episodes."""
    hashes = [hashlib.sha256() for _ in range(games.size)]
    generator = np.random.default_rng(actions)
    for _ in range(episodes):
        snapshot = games.reset(range(games.size))
        for moment in range(13):
            poses = games.poses()
            for row, digest in enumerate(hashes):
                digest.update(snapshot.pixels[row].tobytes())
                digest.update(snapshot.reward[row].tobytes() + poses[row].tobytes())
            if moment < 12:
                # The same actions in a row whatever the number of rows.
                snapshot = games.step(generator.integers(6, size=16).tolist())
    return [digest.hexdigest() for digest in hashes]


class TestSeeds:
    def test_the_same_seed_gives_the_same_bits(self, four: BatchedGames) -> None:
        found = []
        for _ in range(2):
            four.seed(7)
            found.append(digests(four))
        assert found[0] == found[1]
        # Rows have episodes of their own.
        assert len(set(found[0])) == 4

    def test_another_seed_gives_others(self, four: BatchedGames) -> None:
        found = []
        for seed in (7, 8, None, None):
            four.seed(seed)
            found += digests(four, episodes=1)
        assert len(set(found)) == 16

    def test_the_number_of_rows_does_not_matter(
        self, two: BatchedGames, four: BatchedGames
    ) -> None:
        for games in (two, four):
            games.seed(3)
        assert digests(two) == digests(four)[:2]

    def test_history_does_not_matter(self, two: BatchedGames) -> None:
        # Other actions, another length and other doors in the first episode.
        found = []
        for first in (1, 2):
            two.seed(5)
            digests(two, actions=first, episodes=1)
            if first == 2:
                two.set_slot("a", closed=False)
                for _ in range(30):
                    two.step([0, 4])
            found.append(digests(two, actions=9, episodes=1))
        assert found[0] == found[1]

    @pytest.mark.slow
    def test_another_process_gives_the_same_bits(self, two: BatchedGames) -> None:
        output = run(
            "from tests.envs.test_batched_games import digests, make\n"
            "games = make(2)\ngames.seed(11)\nprint(*digests(games))\ngames.close()"
        )
        two.seed(11)
        assert output.split() == digests(two)


class TestLosses:
    @pytest.mark.slow
    def test_the_other_seven_rows_never_notice(self) -> None:
        disturbed, calm = make(8), make(8)
        try:
            for games in (disturbed, calm):
                games.seed(1)
                games.reset(range(8))
            for moment in range(8):
                if moment == 3:
                    os.kill(disturbed.pids[5], signal.SIGKILL)
                actions = [(moment + row) % 6 for row in range(8)]
                expected = calm.step(actions)
                if moment == 3:
                    with pytest.warns(RuntimeWarning, match="maze 5 .* truncated"):
                        found = disturbed.step(actions)
                else:
                    found = disturbed.step(actions)
                others = [row for row in range(8) if row != 5]
                for name in ("pixels", "reward", "truncated"):
                    mine, theirs = (getattr(s, name)[others] for s in (found, expected))
                    np.testing.assert_array_equal(mine, theirs)
                np.testing.assert_array_equal(
                    disturbed.poses()[others], calm.poses()[others]
                )
                assert found.truncated[5] == (moment >= 3)
            # The row's next episode is the one it would have had.
            found, expected = (games.reset([5]) for games in (disturbed, calm))
            np.testing.assert_array_equal(found.pixels[5], expected.pixels[5])
            assert not found.truncated.any()
            assert len(set(disturbed.pids)) == 8
        finally:
            disturbed.close()
            calm.close()

    def test_a_lost_row_can_be_asked_for_doors(self, two: BatchedGames) -> None:
        two.reset([0, 1])
        os.kill(two.pids[0], signal.SIGKILL)
        with pytest.warns(RuntimeWarning, match="maze 0 of the batch lost"):
            two.step([2, 2])
        two.set_slot("a", closed=False)
        assert two.step([2, 2]).truncated.tolist() == [True, False]
        two.reset([0, 1])
        assert two.closed().tolist() == [[True, False]] * 2

    def test_a_loss_between_episodes_costs_none(self, two: BatchedGames) -> None:
        two.seed(2)
        expected = two.reset([0, 1])
        two.seed(2)
        os.kill(two.pids[1], signal.SIGKILL)
        with pytest.warns(RuntimeWarning, match="maze 1 of the batch lost"):
            found = two.reset([0, 1])
        np.testing.assert_array_equal(found.pixels, expected.pixels)
        assert not found.truncated.any()

    def test_nobody_warns_without_a_loss(self, two: BatchedGames) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            digests(two)


def test_a_failed_start_ends_the_engines_that_came_up(registered) -> None:
    before, started, one_by_one = set(registered()), [], threading.Lock()

    def start(*arguments, **options) -> MazeGame:
        with one_by_one:
            if len(started) == 2:
                raise EngineError("no third")
            started.append(MazeGame(*arguments, **options))
            return started[-1]

    engine = replace(VIZDOOM, start=start)
    with pytest.raises(EngineError, match="no third"):
        BatchedGames(engine, GATE, 3, rules=SceneRules(), episode_length=5)
    assert len(started) == 2
    assert set(registered()) == before


@pytest.mark.slow
def test_memory_and_files_stay_flat(two: BatchedGames) -> None:
    process = psutil.Process()
    digests(two, episodes=40)
    memory, files = process.memory_info().rss, process.num_fds()
    digests(two, episodes=150)
    # 150 resets and 1,800 decisions of 2 x 57,600 bytes would be 225 MB.
    assert process.memory_info().rss - memory < 20e6
    assert process.num_fds() == files
