"""`Trajectories`: what environments saw and did, view by view."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from toponav.graph.pieces import Piece


@dataclass(frozen=True)
class Trajectory:
    """Views of one environment that follow on each other, T of them."""

    env: int
    number: int  # of the first among all views of the environment
    embeddings: Tensor  # float16 [T, D]
    actions: Tensor  # int64 [T]; each was done after its view


class Trajectories:
    """All walks so far; a view takes 0.5 kB at 256 numbers.

    Examples:
        >>> walks, views = Trajectories(), torch.zeros(3, 8)
        >>> piece = Piece(0, views, None, False, actions=torch.tensor([0, 0, 1]))
        >>> walks.extend([piece, piece])
        >>> [(walk.number, len(walk.actions)) for walk in walks.all()]
        [(0, 6)]
    """

    def __init__(self) -> None:
        self._done: list[Trajectory] = []
        self._running: dict[int, list[Piece]] = {}
        self._counts: dict[int, int] = {}

    def extend(self, pieces: Sequence[Piece]) -> None:
        """Continue walks by pieces with actions, in order."""
        for piece in pieces:
            self._running.setdefault(piece.env, []).append(_copied(piece))
            if piece.ends:
                self._close(piece.env)

    def end(self, envs: Iterable[int]) -> None:
        """What these environments see next does not follow on their last views."""
        for env in envs:
            if env in self._running:
                self._close(env)

    def _close(self, env: int) -> None:
        walk = self._join(env)
        del self._running[env]
        self._counts[env] = walk.number + len(walk.actions)
        self._done.append(walk)

    def _join(self, env: int) -> Trajectory:
        pieces = self._running[env]
        actions = [piece.actions for piece in pieces if piece.actions is not None]
        seen = torch.cat([piece.embeddings for piece in pieces])
        return Trajectory(env, self._counts.get(env, 0), seen, torch.cat(actions))

    def all(self) -> list[Trajectory]:
        """Those that ended, then those that go on."""
        return [*self._done, *map(self._join, self._running)]

    def state_dict(self) -> dict[str, Any]:
        """All walks; those that go on end where they are."""
        return {"walks": [vars(walk) for walk in self.all()]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Become what `state_dict` gave; observations are counted from 0 again."""
        self._done = [Trajectory(**walk) for walk in state["walks"]]
        self._running, self._counts = {}, {}

    def running_episodes(self) -> dict[str, Any]:
        """Which of the last walks go on, and counts of observations."""
        return {"envs": [*self._running], "counts": dict(self._counts)}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        """Continue those of `running_episodes`, after `load_state_dict`."""
        self._counts = dict(state["counts"])
        number = len(self._done) - len(state["envs"])
        for walk in self._done[number:]:
            piece = Piece(walk.env, walk.embeddings, None, False, None, walk.actions)
            self._running[walk.env] = [piece]
        del self._done[number:]


def _copied(piece: Piece) -> Piece:
    """What is kept of a piece; slices would keep the whole batch, its views too."""
    actions = None if piece.actions is None else piece.actions.clone()
    seen = piece.embeddings.to(torch.half, copy=True)
    return replace(piece, embeddings=seen, images=None, turns=None, actions=actions)
