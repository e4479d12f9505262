"""Loops: back where it was, having been elsewhere since."""

import pytest
import torch
from tensordict import TensorDict

from tests.checks import check_transform
from tests.fakes import FakeMaze
from toponav.keys import LOOP_CLOSED, POSITION
from toponav.transforms import LoopClosure

NEAR, FAR = 1.0, 2.5


def at(position: torch.Tensor, rows: list[bool] | None = None) -> TensorDict:
    data = TensorDict({POSITION: position}, [len(position)])
    if rows is not None:
        data["_reset"] = torch.tensor(rows).unsqueeze(-1)
    return data


def label(path: torch.Tensor) -> list[bool]:
    """The definition, for the last position of a path ``[N, 2]``."""
    away = (path[:-1] - path[-1]).norm(dim=-1).tolist()
    found = False
    for earlier, distance in enumerate(away):
        if distance <= NEAR:
            found |= any(later > FAR for later in away[earlier + 1 :])
    return found


def test_it_is_the_definition_on_random_paths_and_over_resets() -> None:
    generator = torch.Generator().manual_seed(0)
    moves = torch.randint(-1, 2, (3, 120, 2), generator=generator).float()
    paths = moves.cumsum(1)
    loops = LoopClosure(near=NEAR, far=FAR)
    start = [0, 0, 0]
    loops._reset(TensorDict(batch_size=[3]), at(paths[:, 0]))
    closed = []
    for now in range(1, 120):
        if now == 50:
            # The first and the last begin a new episode here.
            rows = at(paths[:, now], [True, False, True])
            found = loops._reset(rows, at(paths[:, now]))[LOOP_CLOSED]
            assert not found[[0, 2]].any()
            start = [now, 0, now]
            continue
        found = loops._step(TensorDict(), at(paths[:, now]))[LOOP_CLOSED].squeeze(-1)
        # The one that goes on has seen nothing in the decision of the reset.
        known = [paths[row, start[row] : now + 1] for row in range(3)]
        known[1] = torch.cat([known[1][:50], known[1][51:]]) if now > 50 else known[1]
        assert found.tolist() == [label(one) for one in known]
        closed.append(found)
    share = torch.stack(closed).float().mean(0)
    assert 0.05 < float(share.min()) < float(share.max()) < 0.95


def test_positions_of_episodes_that_are_over_are_forgotten() -> None:
    loops = LoopClosure(near=NEAR, far=FAR)
    here = at(torch.zeros(2, 2))
    loops._reset(TensorDict(batch_size=[2]), here)
    for _ in range(9):
        loops._step(TensorDict(), here)
    loops._reset(at(torch.zeros(2, 2), [True, False]), here)
    assert loops.path.shape == (2, 11, 2)
    loops._step(TensorDict(), here)
    loops._reset(at(torch.zeros(2, 2), [False, True]), here)
    # What the first has seen since it began, and nothing from before.
    assert loops.path.shape == (2, 3, 2)


def test_specs_hold_under_every_nesting() -> None:
    check_transform(
        lambda batch_size=(): FakeMaze(batch_size=batch_size, max_decisions=4),
        lambda: LoopClosure(near=NEAR, far=FAR),
    )


def test_one_that_was_saved_goes_on() -> None:
    path = torch.tensor([[0.0, 0], [3, 0], [0, 0]])
    whole, other = (LoopClosure(near=NEAR, far=FAR) for _ in range(2))
    whole._reset(TensorDict(batch_size=[1]), at(path[:1]))
    whole._step(TensorDict(), at(path[1:2]))
    other.load_state_dict(whole.state_dict())
    for one in (whole, other):
        assert one._step(TensorDict(), at(path[2:]))[LOOP_CLOSED].item()


@pytest.mark.parametrize(("near", "far"), [(0.0, 1.0), (2.0, 2.0), (3.0, 1.0)])
def test_distances_out_of_order_are_refused(near: float, far: float) -> None:
    with pytest.raises(ValueError, match="near must be above 0 and below far"):
        LoopClosure(near=near, far=far)
