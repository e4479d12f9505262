"""Positions that fit steps and closures best, those aside that fit nothing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import cg

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

#: Keeps the matrix regular: positions are known but for a common shift.
_ANCHOR = 1e-9
_PRECISION, _MOST_STEPS = 1e-6, 3000


def redescending(residual: Floats, scale: float) -> Floats:
    """Weights of Geman and McClure, in (0, 1]: what is far beyond ``scale`` has none.

    Examples:
        >>> redescending(np.array([0.0, 2.0, 20.0]), 2.0).round(4).tolist()
        [1.0, 0.25, 0.0001]
    """
    weights: Floats = (scale**2 / (scale**2 + residual**2)) ** 2
    return weights


@dataclass
class PositionProblem:
    """V positions; B pairs whose difference is said to be ``step``, with weights.

    Linear, since directions are known: each coordinate is a sparse system of its own.

    Examples:
        >>> pairs = np.array([0, 1, 0]), np.array([1, 2, 2])
        >>> steps = np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
        >>> problem = PositionProblem(3, *pairs, steps)
        >>> found = problem.solve(np.ones(3), np.zeros((3, 2)))
        >>> (found - found[0]).round(3)[:, 0].tolist()
        [0.0, 1.0, 2.0]
    """

    num: int
    one: Numbers
    other: Numbers
    step: Floats  # [B, 2]; from one to the other

    def residual(self, positions: Floats) -> Floats:
        """How far each pair is from what is said of it, ``[B]``."""
        gap = positions[self.other] - positions[self.one] - self.step
        length: Floats = np.linalg.norm(gap, axis=1)
        return length

    def solve(self, weights: Floats, start: Floats) -> Floats:
        """The positions ``[V, 2]`` of least weighted squares, found from ``start``."""
        one, other = self.one, self.other
        entries = np.concatenate([weights, weights, -weights, -weights])
        rows = np.concatenate([one, other, one, other])
        columns = np.concatenate([one, other, other, one])
        matrix = coo_array((entries, (rows, columns)), shape=(self.num, self.num))
        matrix = (matrix + diags_array(np.full(self.num, _ANCHOR))).tocsr()
        right = np.zeros((self.num, 2))
        np.add.at(right, other, weights[:, None] * self.step)
        np.add.at(right, one, -weights[:, None] * self.step)
        scale = diags_array(1 / matrix.diagonal())
        options = {"M": scale, "rtol": _PRECISION, "maxiter": _MOST_STEPS}
        found = [
            cg(matrix, right[:, axis], x0=start[:, axis], **options)[0]
            for axis in range(2)
        ]
        return np.stack(found, 1)
