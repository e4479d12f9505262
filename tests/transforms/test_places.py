"""How many squares of the floor an episode has entered."""

import pytest
import torch
from tensordict import TensorDict

from toponav.keys import PLACES, POSITION
from toponav.transforms import PlacesVisited


def at(*positions: tuple[float, float], restart: list[bool] | None = None):
    data = TensorDict({POSITION: torch.tensor(positions)}, [len(positions)])
    if restart is not None:
        data["_reset"] = torch.tensor(restart).unsqueeze(-1)
    return data


def test_each_env_counts_the_squares_of_its_episode() -> None:
    meter = PlacesVisited(0.5)
    start = at((0.1, 0.1), (3.0, 3.0))
    assert meter._reset(TensorDict(batch_size=[2]), start)[PLACES].tolist() == [
        [1],
        [1],
    ]
    walk = [
        # Squares of the first env: (0, 0), (1, 0), (0, 0), (0, -1); of the second:
        # (6, 6), (6, 6), (5, 6), (6, 6).
        (at((0.4, 0.4), (3.4, 3.4)), [1, 1]),
        (at((0.6, 0.4), (3.2, 3.0)), [2, 1]),
        (at((0.1, 0.4), (2.9, 3.0)), [2, 2]),
        (at((0.1, -0.1), (3.0, 3.1)), [3, 2]),
    ]
    for data, expected in walk:
        assert meter._call(data)[PLACES].flatten().tolist() == expected


def test_a_partial_reset_forgets_one_episode() -> None:
    meter = PlacesVisited(1.0)
    meter._reset(TensorDict(batch_size=[2]), at((0.0, 0.0), (0.0, 0.0)))
    meter._call(at((1.0, 0.0), (1.0, 0.0)))
    mask = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    again = meter._reset(mask, at((5.0, 0.0), (1.0, 0.0)))
    assert again[PLACES].flatten().tolist() == [1, 2]
    assert meter._call(at((0.0, 0.0), (0.0, 0.0)))[PLACES].flatten().tolist() == [2, 2]


def test_it_follows_the_position_to_another_device(device: str) -> None:
    meter = PlacesVisited(1.0)
    assert meter.squares.device.type == "cpu"
    meter._reset(TensorDict(batch_size=[2]), at((0.5, 0.5), (0.5, 0.5)).to(device))
    data = meter._call(at((1.5, 0.5), (0.9, 0.1)).to(device))
    assert meter.squares.device == data[POSITION].device
    # The first is in the square beside, the second where it was.
    assert data[PLACES].flatten().cpu().tolist() == [2, 1]
    # A new episode of the first, whose mask is on the processor.
    mask = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    again = meter._reset(mask, at((5.5, 0.5), (0.9, 0.1)).to(device))
    assert again[PLACES].flatten().cpu().tolist() == [1, 1]


def test_a_size_of_zero_is_refused() -> None:
    with pytest.raises(ValueError, match="size must be above 0, got 0"):
        PlacesVisited(0.0)
