"""Episodes that the world ends within a walk, and networks that compare places."""

import torch
from tensordict import TensorDict

from tests.comparing_networks import Places
from toponav.data import HeldOut
from toponav.keys import ACTION, NETWORK_PIXELS


def cut_walk(*episodes: list[int]) -> HeldOut:
    """Two walks of the same episodes, each of which lists the places of its views."""
    seen = torch.tensor([place for one in episodes for place in one]).repeat(2, 1)
    length = torch.tensor([len(one) for one in episodes])
    done = torch.zeros(*seen.shape, 1, dtype=torch.bool)
    done[:, length.cumsum(0) - 1] = True
    frames = {NETWORK_PIXELS: seen.unsqueeze(-1), ACTION: torch.zeros_like(seen)}
    frames["next"] = TensorDict({"done": done}, seen.shape)
    return HeldOut(TensorDict(frames, seen.shape), name="game")


def two_rooms() -> tuple[HeldOut, Places]:
    """Episodes to and fro between 0 and 1, in turn with such between 2 and 3.

    Views a step apart are similar to 0.6, those of two episodes to 0.52 or less.
    """
    table = torch.full((4, 4), 0.52)
    table[:2, :2] = table[2:, 2:] = 0.6
    return cut_walk(*[[0, 1, 0, 1], [2, 3, 2, 3]] * 4), Places(table.fill_diagonal_(1))


def one_start() -> tuple[HeldOut, Places]:
    """Twenty episodes from 0: in two of them to 2, which is like nothing, else to 1."""
    table = torch.tensor([[1.0, 0.6, 0.3], [0.6, 1.0, 0.3], [0.3, 0.3, 1.0]])
    near, far = [0] * 5 + [1] * 5, [0] * 5 + [2] * 5
    return cut_walk(*[near] * 9, far, *[near] * 9, far), Places(table)
