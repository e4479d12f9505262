from functools import partial

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from tests.checks import check_parallel, check_transform
from tests.fakes import TINY, FakeMaze, parse
from toponav.keys import BLOCKED, CELL, COVERAGE, COVERAGE_REWARD, DECISIONS_TO_COVERAGE
from toponav.transforms import Coverage

CORRIDOR = torch.ones(1, 4, dtype=torch.bool)


def at(*columns, blocked=None):
    """Return the envs' cells in a corridor, and whether its slot is closed."""
    cells = torch.tensor([[0, column] for column in columns])
    data = TensorDict({CELL: cells}, batch_size=[len(columns)])
    if blocked is not None:
        data[BLOCKED] = torch.tensor(blocked).unsqueeze(-1)
    return data


def reset(meter, data, rows=None):
    mask = TensorDict(batch_size=data.batch_size)
    if rows is not None:
        mask["_reset"] = torch.tensor(rows).unsqueeze(-1)
    return meter._reset(mask, data)


def step(meter, data):
    return meter._step(TensorDict(batch_size=data.batch_size), data)


def test_worked_numbers():
    # Two envs in a corridor of four cells; the start cell is 1/4.
    meter = Coverage(CORRIDOR, levels=(0.25, 0.5, 0.9, 1.0))
    data = reset(meter, at(0, 3))
    assert data[COVERAGE].squeeze(-1).tolist() == [0.25, 0.25]
    assert data[DECISIONS_TO_COVERAGE].tolist() == [[0, -1, -1, -1]] * 2
    # decision         1       2       3       4
    paths = [(0, 2), (1, 2), (2, 3), (3, 2)]
    seen = [step(meter, at(*cells)) for cells in paths]
    assert [d[COVERAGE].squeeze(-1).tolist() for d in seen] == [
        [0.25, 0.5],
        [0.5, 0.5],
        [0.75, 0.5],
        [1.0, 0.5],
    ]
    assert [d[COVERAGE_REWARD].squeeze(-1).tolist() for d in seen] == [
        [0, 1],
        [1, 0],
        [1, 0],
        [1, 0],
    ]
    assert seen[-1][DECISIONS_TO_COVERAGE].tolist() == [[0, 2, 4, 4], [0, 1, -1, -1]]


def test_nine_of_ten_cells_are_90_percent():
    # 0.9 * 10 is 9.0000000000000002 in some arithmetic, which must not matter.
    meter = Coverage(torch.ones(1, 10, dtype=torch.bool), levels=(0.9,))
    reset(meter, at(0))
    reached = [step(meter, at(c))[DECISIONS_TO_COVERAGE].item() for c in range(1, 10)]
    assert reached == [-1] * 7 + [8, 8]


def test_a_new_episode_forgets_only_the_rows_that_restart():
    meter = Coverage(CORRIDOR)
    reset(meter, at(0, 0))
    step(meter, at(1, 1))
    data = reset(meter, at(3, 3), [True, False])
    assert data[COVERAGE].squeeze(-1).tolist() == [0.25, 0.5]
    assert data[DECISIONS_TO_COVERAGE].tolist() == [[-1, -1, -1], [1, -1, -1]]
    data = step(meter, at(2, 2))
    assert data[COVERAGE].squeeze(-1).tolist() == [0.5, 0.75]
    # Row 0 counts from its own start: one decision. Row 1 was there at decision 1.
    assert data[DECISIONS_TO_COVERAGE][:, 0].tolist() == [1, 1]


def test_rows_that_go_on_ignore_what_a_partial_reset_shows_them():
    # SerialEnv fills the rows that do not restart with anything.
    meter = Coverage(CORRIDOR)
    reset(meter, at(0, 1))
    reset(meter, at(3, -1), [True, False])
    assert step(meter, at(3, 3))[COVERAGE].squeeze(-1).tolist() == [0.25, 0.5]


def test_closed_slot_is_no_open_cell():
    # With column 3 closed, three cells are the whole maze.
    meter = Coverage(CORRIDOR, slot_cells=[(0, 3)])
    reset(meter, at(0, 0, blocked=[True, False]))
    for column in (1, 2):
        data = step(meter, at(column, column, blocked=[True, False]))
    assert data[COVERAGE].squeeze(-1).tolist() == [1.0, 0.75]
    assert data[DECISIONS_TO_COVERAGE].tolist() == [[1, 2, 2], [1, -1, -1]]


def test_slot_that_opens_lowers_coverage_but_not_what_was_reached():
    meter = Coverage(CORRIDOR, slot_cells=[(0, 3)])
    reset(meter, at(0, blocked=[True]))
    for column in (1, 2):
        step(meter, at(column, blocked=[True]))
    data = step(meter, at(2, blocked=[False]))
    assert data[COVERAGE].item() == 0.75
    assert data[DECISIONS_TO_COVERAGE].tolist() == [[1, 2, 2]]


def test_visited_slot_that_closes_counts_no_more():
    meter = Coverage(CORRIDOR, slot_cells=[(0, 1)])
    reset(meter, at(0, blocked=[False]))
    step(meter, at(1, blocked=[False]))
    assert step(meter, at(2, blocked=[False]))[COVERAGE].item() == 0.75
    # Columns 0 and 2 of the columns 0, 2 and 3.
    assert step(meter, at(2, blocked=[True]))[COVERAGE].item() == pytest.approx(2 / 3)


def test_a_wall_cell_is_never_covered():
    mask = torch.tensor([[True, False, True]])
    meter = Coverage(mask)
    reset(meter, at(0))
    data = step(meter, at(1))
    assert (data[COVERAGE].item(), data[COVERAGE_REWARD].item()) == (0.5, 0.0)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_coverage_is_the_number_of_different_cells(data):
    rows, columns = data.draw(st.tuples(st.integers(1, 4), st.integers(1, 4)))
    num_cells = rows * columns
    walk = data.draw(st.lists(st.integers(0, num_cells - 1), min_size=1, max_size=30))
    meter = Coverage(torch.ones(rows, columns, dtype=torch.bool), levels=(0.5, 1.0))
    cells = [
        TensorDict({CELL: torch.tensor([c // columns, c % columns])}) for c in walk
    ]
    out = [meter._reset(TensorDict(), cells[0])]
    out += [meter._step(TensorDict(), cell) for cell in cells[1:]]
    counts = [len(set(walk[: t + 1])) for t in range(len(walk))]
    assert [round(d[COVERAGE].item() * num_cells) for d in out] == counts
    rewards = [d[COVERAGE_REWARD].item() for d in out[1:]]
    assert sum(rewards) == counts[-1] - 1
    for level, reached in zip(
        (0.5, 1.0), out[-1][DECISIONS_TO_COVERAGE].tolist(), strict=True
    ):
        enough = [t for t, count in enumerate(counts) if count >= level * num_cells]
        assert reached == (enough[0] if enough else -1)


def test_state_dict_goes_on_where_it_was_saved():
    saved, loaded = Coverage(CORRIDOR), Coverage(CORRIDOR)
    reset(saved, at(0, 0))
    step(saved, at(1, 0))
    loaded.load_state_dict(saved.state_dict())
    for meter in (saved, loaded):
        data = step(meter, at(2, 1))
        assert data[COVERAGE].squeeze(-1).tolist() == [0.75, 0.5]
        assert data[DECISIONS_TO_COVERAGE][:, 0].tolist() == [1, 2]


def test_earlier_results_do_not_change_afterwards():
    meter = Coverage(CORRIDOR)
    reset(meter, at(0))
    last = step(meter, at(1))
    reset(meter, at(3))
    assert last[DECISIONS_TO_COVERAGE].tolist() == [[1, -1, -1]]


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


def make_coverage():
    mask, slots = parse(TINY)
    return Coverage(mask, slot_cells=list(slots.values()))


def test_specs_hold_under_every_nesting():
    check_transform(make_maze, make_coverage)


def test_specs_hold_for_keys_of_ones_own():
    mask, _ = parse(TINY)
    keys = ["share", ("score", "new_cells"), ("score", "reached")]
    check_transform(make_maze, partial(Coverage, mask, out_keys=keys))


@pytest.mark.slow
def test_specs_hold_in_processes():
    check_parallel(make_maze, make_coverage)


def test_a_reset_leaves_it_in_its_env():
    # Else all specs of the env are computed again, in each reset.
    env = TransformedEnv(make_maze([2]), make_coverage())
    within = env.transform.parent
    env.reset()
    assert env.transform.parent is within


def test_it_follows_what_it_reads_to_another_device(device):
    meter = Coverage(CORRIDOR, levels=(0.5,))
    assert meter.visited.device.type == "cpu"
    data = reset(meter, at(0, 3).to(device))
    assert meter.visited.device == data[CELL].device
    # Two of four cells after one decision.
    data = step(meter, at(1, 2).to(device))
    assert data[COVERAGE].flatten().cpu().tolist() == [0.5, 0.5]


def test_rollout_of_a_maze_has_the_keys_and_their_types():
    env = TransformedEnv(make_maze([2]), make_coverage())
    data = env.rollout(5)["next"]
    assert data[COVERAGE].shape == (2, 5, 1)
    assert data[COVERAGE].dtype is torch.float32
    assert data[COVERAGE_REWARD].dtype is torch.float32
    assert data[DECISIONS_TO_COVERAGE].shape == (2, 5, 3)
    assert (data[COVERAGE].diff(dim=1) >= 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"open_mask": torch.ones(2, 2)},
            "open_mask must be bool .* got torch.float32",
        ),
        ({"open_mask": torch.zeros(2, 2, dtype=torch.bool)}, "must have an open cell"),
        ({"levels": ()}, r"levels must be in \(0, 1\], got \(\)"),
        ({"levels": (0.5, 1.1)}, r"levels must be in \(0, 1\], got \(0.5, 1.1\)"),
        ({"slot_cells": [(0, 9)]}, r"slot_cells must be open cells, got \(0, 9\)"),
        ({"out_keys": ["a"]}, "in_keys must be 1 and out_keys 3"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Coverage(**{"open_mask": CORRIDOR} | arguments)


@pytest.mark.parametrize(
    ("meter", "message"),
    [
        (
            partial(Coverage, CORRIDOR, in_keys=["where"]),
            "'where' must be an observation",
        ),
        (
            partial(Coverage, CORRIDOR, slot_cells=[(0, 1), (0, 2)]),
            r"'blocked'\) must be \[\*B, 2\], got \[1\]",
        ),
    ],
)
def test_wrong_keys_are_refused_with_the_specs(meter, message):
    with pytest.raises(ValueError, match=message):
        TransformedEnv(FakeMaze(), meter()).observation_spec  # noqa: B018


@pytest.mark.parametrize("shape", [(4, 5), (5, 4)])
def test_a_mask_smaller_than_the_maze_is_refused_with_the_specs(shape):
    # TINY has five rows and five columns.
    env = TransformedEnv(FakeMaze(), Coverage(torch.ones(shape, dtype=torch.bool)))
    message = rf"at least \[5, 5\], got \[{shape[0]}, {shape[1]}\]"
    with pytest.raises(ValueError, match=message):
        env.observation_spec  # noqa: B018
