from pathlib import Path

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, ReplayBuffer

from toponav.data import Episodes, find_episodes

TRAJECTORY = ("collector", "traj_ids")


def make_frames(lengths: list[int], first: int = 0) -> TensorDict:
    """Whole episodes, numbered from ``first``, one after the other."""
    episode = torch.repeat_interleave(
        torch.arange(first, first + len(lengths)), torch.tensor(lengths)
    )
    step = torch.cat([torch.arange(length) for length in lengths])
    return TensorDict(
        {
            "collector": {"traj_ids": episode},
            "step_count": step.unsqueeze(-1),
        },
        [len(step)],
    )


def read(buffer: ReplayBuffer, episodes: Episodes) -> list[list[tuple[int, int]]]:
    """Episode and step of every frame of every run."""
    data = buffer.storage[:].reshape(-1)[episodes.order]
    pairs = list(
        zip(data[TRAJECTORY].tolist(), data["step_count"][:, 0].tolist(), strict=True)
    )
    return [
        pairs[start : start + length]
        for start, length in zip(
            episodes.start.tolist(), episodes.length.tolist(), strict=True
        )
    ]


def check_runs(runs: list[list[tuple[int, int]]], num_frames: int) -> None:
    """Every frame once; a run is one episode's successive steps."""
    seen = [pair for run in runs for pair in run]
    assert len(set(seen)) == len(seen) == num_frames
    for run in runs:
        assert {episode for episode, _ in run} == {run[0][0]}
        assert [step - run[0][1] for _, step in run] == list(range(len(run)))


lengths = st.lists(st.integers(1, 12), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None)
@given(lengths=lengths, capacity=st.integers(1, 60), block=st.integers(1, 9))
def test_runs_of_a_ring_buffer_never_mix_episodes(
    lengths: list[int], capacity: int, block: int
) -> None:
    buffer = ReplayBuffer(storage=LazyTensorStorage(capacity))
    frames = make_frames(lengths)
    for part in frames.split(min(block, capacity)):
        buffer.extend(part)
    episodes = find_episodes(buffer.storage)
    check_runs(read(buffer, episodes), min(capacity, len(frames)))


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(lengths, min_size=2, max_size=3),
    rows=st.integers(3, 30),
    block=st.integers(1, 3),
)
def test_runs_of_several_environments_never_mix(
    lengths: list[list[int]], rows: int, block: int
) -> None:
    frames = [make_frames(part, 100 * env) for env, part in enumerate(lengths)]
    num_steps = min(len(part) for part in frames)
    rollout = torch.stack([part[:num_steps] for part in frames])
    num_envs = len(frames)
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(rows * num_envs, ndim=2), dim_extend=1
    )
    for part in rollout.split(block, dim=1):
        buffer.extend(part)
    kept = min(rows, num_steps) * num_envs
    check_runs(read(buffer, find_episodes(buffer.storage)), kept)


def test_writers_that_take_turns_are_told_apart_by_trajectory(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    storage = LazyMemmapStorage(40, scratch_dir=tmp_path_factory.mktemp("ring"))
    buffer = ReplayBuffer(storage=storage)
    for one, two in zip(
        make_frames([12, 20]).split(4), make_frames([20, 12], 10).split(4), strict=True
    ):
        buffer.extend(one)
        buffer.extend(two)
    episodes = find_episodes(buffer.storage)
    runs = read(buffer, episodes)
    check_runs(runs, 40)
    # 64 frames were written and 40 kept: of each writer the last 20. The 41st is row 0,
    # and the 45th, where the other's second episode begins, row 4.
    assert [(run[0], len(run)) for run in runs] == [
        ((1, 0), 20),
        ((11, 0), 12),
        ((10, 12), 8),
    ]


@given(st.permutations(range(4)))
def test_numbers_of_episodes_say_nothing_of_their_order(numbers: list[int]) -> None:
    frames = make_frames([3, 5, 2, 4])
    buffer = ReplayBuffer(storage=LazyTensorStorage(14))
    frames[TRAJECTORY] = torch.tensor(numbers)[frames[TRAJECTORY].long()]
    buffer.extend(frames)
    episodes = find_episodes(buffer.storage)
    assert episodes.length.tolist() == [3, 5, 2, 4]
    assert episodes.order.tolist() == list(range(14))


def test_runs_of_an_episode_with_a_gap_share_their_group() -> None:
    frames = make_frames([3, 9])
    buffer = ReplayBuffer(storage=LazyTensorStorage(20))
    buffer.extend(torch.cat([frames[:7], frames[9:]]))
    episodes = find_episodes(buffer.storage)
    assert episodes.length.tolist() == [3, 4, 3]
    assert episodes.first_step.tolist() == [0, 0, 6]
    assert episodes.group_start.tolist() == [0, 3, 3]
    assert episodes.group_length.tolist() == [3, 7, 7]


def test_a_repeated_trajectory_number_is_refused() -> None:
    buffer = ReplayBuffer(storage=LazyTensorStorage(20))
    buffer.extend(make_frames([5]))
    buffer.extend(make_frames([5]))
    with pytest.raises(ValueError, match="must be unique in the storage, got two"):
        find_episodes(buffer.storage)


@pytest.mark.filterwarnings("ignore:Loading the storage:UserWarning")
def test_a_full_ring_that_was_loaded_is_read(tmp_path: Path) -> None:
    # TorchRL does not save where a ring was written last: nobody needs it.
    first, second = (ReplayBuffer(storage=LazyTensorStorage(20)) for _ in range(2))
    first.extend(make_frames([12]))
    first.extend(make_frames([30], 1)[:13])
    first.dumps(tmp_path)
    second.loads(tmp_path)
    episodes = find_episodes(second.storage)
    # The second begins again at row 0.
    assert episodes.length.tolist() == [13, 7]


def test_an_empty_storage_has_no_episodes() -> None:
    episodes = find_episodes(LazyTensorStorage(10))
    assert len(episodes.length) == 0
    with pytest.raises(ValueError, match=r"at least 1 decisions \(one\), got 0"):
        episodes.require(1, "one")


def test_a_place_knows_its_run() -> None:
    episodes = Episodes.from_lengths([3, 1, 2])
    assert episodes.run_of(torch.arange(6)).tolist() == [0, 0, 0, 1, 2, 2]


@pytest.mark.parametrize("key", ["step_count", TRAJECTORY])
def test_frames_without_their_place_are_refused(key: str | tuple[str, str]) -> None:
    buffer = ReplayBuffer(storage=LazyTensorStorage(9))
    buffer.extend(make_frames([4]).exclude(key))
    with pytest.raises(KeyError, match=r"traj_ids.*collectors write.*StepCounter"):
        find_episodes(buffer._storage)
