"""`Steps`: how far each action led, as far as it is known."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, stack

from toponav.graph.poses.odometry import Odometry

Floats = NDArray[np.float64]

#: Steps that an agent may go on by itself after an action, at most.
_CARRY = 0.1
#: Actions that lead at least so far in free space are moves.
_MOVE = 0.6


class Steps:
    """The S steps of all walks, seen from the agent, at first those of free space.

    Args:
        first: the view before each step, int64 ``[S]``; the one after it is the next.
        headings: of the V views in degrees, ``[V]``.
        actions: of the views, int64 ``[V]``.
        effects: of the actions in free space, ``[A, 3]``.
        embeddings: of the views, ``[V, D]``.
        overshoot, free_moves, updates, seed: see `PoseRules`.
    """

    def __init__(
        self,
        first: NDArray[np.int64],
        headings: Floats,
        actions: Tensor,
        effects: Tensor,
        embeddings: Tensor,
        *,
        overshoot: float,
        free_moves: float,
        updates: int,
        seed: int,
    ) -> None:
        self.first = first
        angle = np.deg2rad(np.nan_to_num(headings[first]))
        self._cos, self._sin = np.cos(angle), np.sin(angle)
        self._overshoot, self._free_moves = overshoot, free_moves
        #: Ahead and to the left, ``[S, 2]``.
        self.estimate: Floats = effects[actions[first], :2].double().numpy()
        self._longest = np.linalg.norm(self.estimate, axis=1)
        done = stack([actions[np.maximum(first - 1, 0)], actions[first]], 1)
        seen = embeddings[first], embeddings[first + 1]
        self._odometry = Odometry(*seen, done, len(effects), updates=updates, seed=seed)

    def in_the_plan(self) -> Floats:
        """The steps as differences of positions, ``[S, 2]``."""
        ahead, left = self.estimate.T
        east = ahead * self._cos - left * self._sin
        return np.stack([east, ahead * self._sin + left * self._cos], 1)

    def learn(self, positions: Floats) -> None:
        """Move the estimates to what positions say of them, and smooth them."""
        east, north = (positions[self.first + 1] - positions[self.first]).T
        ahead = east * self._cos + north * self._sin
        said = np.stack([ahead, north * self._cos - east * self._sin], 1)
        wanted = self.estimate + self._overshoot * (said - self.estimate)
        found = self._odometry.fit(self._limited(wanted))
        # Positions shrink where steps are not held: free moves have the known length.
        moves = self._longest > _MOVE
        if moves.any():
            share = np.linalg.norm(found[moves], axis=1) / self._longest[moves]
            found /= max(float(np.quantile(share, 1 - self._free_moves)), 1e-3)
        self.estimate = self._limited(found)

    def _limited(self, steps: Floats) -> Floats:
        """No longer than in free space, but for what is carried over from the last."""
        length = np.linalg.norm(steps, axis=1)
        most = (self._longest + _CARRY) / np.maximum(length, 1e-6)
        limited: Floats = steps * np.minimum(1.0, most)[:, None]
        return limited
