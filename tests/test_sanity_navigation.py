"""What benchmarks/sanity_navigation.py measures, and what its memory task asks."""

import importlib
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict

FOLDER = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("sanity_navigation")


@pytest.fixture
def tasks(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("sanity_tasks")


def test_only_the_end_of_the_first_episode_counts(benchmark: ModuleType) -> None:
    done = torch.tensor([[0, 1, 0, 1], [0, 0, 0, 1], [1, 1, 1, 1]], dtype=torch.bool)
    reward = torch.tensor([[5.0, 0.5, 7, 9], [3, 3, 3, 0], [0.75, 1, 1, 1]])
    later = {"done": done.unsqueeze(-1), "reward": reward.unsqueeze(-1)}
    steps = TensorDict({"next": TensorDict(later, [3, 4])}, [3, 4])
    assert benchmark.last_rewards(steps).tolist() == [0.5, 0, 0.75]
    # (0.5 + 0 + 0.75) / 3, and two of three were paid.
    measured = benchmark.measure_rooms(steps)
    assert measured == pytest.approx({"reward": 1.25 / 3, "success": 2 / 3})


@pytest.mark.parametrize("task", ["catch", "recall", "goal", "match", "maze"])
def test_the_settings_of_a_task_fit_each_other(tasks: ModuleType, task: str) -> None:
    chosen = tasks.TASKS[task]
    for loss in chosen.learners:
        settings = tasks.settings_of(task, loss, 0)
        batch = settings.collect.envs * settings.loss.rollout
        # Rows are written at the ends of batches.
        assert chosen.every % batch == chosen.decisions % chosen.every == 0
        assert (settings.loss.name, settings.seed) == (loss, 0)


Pose = tuple[int, int, int]


class Corridor:
    """The squares of MemoryS7, and from where its objects are seen."""

    ahead = ((1, 0), (0, 1), (-1, 0), (0, -1))

    def __init__(self, options: dict[str, int]) -> None:
        self.env = gymnasium.make("minigrid:MiniGrid-MemoryS7-v0", **options).unwrapped
        self.env.reset(seed=0)
        # No square beyond the walls has a pose.
        squares = [(x, y) for x in range(7) for y in range(7)]
        free = [square for square in squares if self.env.grid.get(*square) is None]
        self.poses = {(*square, d) for square in free for d in range(4)}

    def sees(self, pose: Pose, square: tuple[int, int]) -> bool:
        self.env.agent_pos, self.env.agent_dir = np.array(pose[:2]), pose[2]
        return bool(self.env.agent_sees(*square))

    def following(self, pose: Pose) -> Iterator[Pose]:
        x, y, d = pose
        dx, dy = self.ahead[d]
        yield from ((x, y, (d + 1) % 4), (x, y, (d - 1) % 4))
        if (x + dx, y + dy, d) in self.poses:
            yield x + dx, y + dy, d

    def decisions(self, start: list[Pose], is_end: Callable[[Pose], bool]) -> int:
        """The fewest from one of ``start`` to an end."""
        known, front = set(start), deque((pose, 0) for pose in start)
        while front:
            pose, number = front.popleft()
            if is_end(pose):
                return number
            new = set(self.following(pose)) - known
            known |= new
            front.extend((one, number + 1) for one in new)
        raise AssertionError("no way to the end")


def test_the_end_of_the_corridor_is_six_decisions_from_its_sign(
    tasks: ModuleType,
) -> None:
    settings = tasks.settings_of("match", "drqn", 0)
    options = dict(settings.world.choices.options)
    corridor = Corridor(options)
    # MiniGrid puts the first object above the middle row, the others at both ends.
    assert options["agent_view_size"] == 3
    assert corridor.env.grid.get(1, 2).type in ("key", "ball")
    start = [pose for pose in corridor.poses if corridor.sees(pose, (1, 2))]
    ends = (corridor.env.success_pos, corridor.env.failure_pos)
    assert {*ends} == {(5, 2), (5, 4)}
    # From (3, 3), looking back: two turns, two steps, a turn and a step.
    assert (3, 3, 2) in start
    assert corridor.decisions(start, lambda pose: pose[:2] in ends) == 6
    drqn, dqn = settings.loss, tasks.settings_of("match", "dqn", 0).loss
    assert dqn.frames < 6 < drqn.unroll


def test_a_game_of_recall_pays_what_its_sign_said(tasks: ModuleType) -> None:
    game = tasks.GAMES["recall"](2, seed=0)
    # Sign, decisions so far, length of the way: one at its junction, one before it.
    state = torch.tensor([[1, 6, 6], [1, 5, 6]])
    moved, reward, over = game.move(state, torch.tensor([1, 0]))
    assert (reward.tolist(), over.tolist()) == ([1, 0], [True, False])
    assert moved[:, 1].tolist() == [7, 6]
    _, reward, _ = game.move(state, torch.tensor([0, 0]))
    assert reward.tolist() == [-1, 0]
    # The sign is on the right half of the first view, and nowhere later.
    views = game.draw(torch.tensor([[1, 0, 6], [1, 1, 6]]))
    assert views[0, 0, :, 0].tolist() == [60] * 18 + [255] * 18
    assert views[1].unique().tolist() == [60]
