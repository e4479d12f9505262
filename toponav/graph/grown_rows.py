"""`GrownRows`: a tensor that gets longer, without being copied each time."""

import torch
from torch import Tensor


class GrownRows:
    """Rows of one shape and dtype; more are appended in amortised constant time.

    Args:
        rows: ``[N, ...]``, the first ones; without any, the first `append` says shape
            and dtype.

    Examples:
        >>> rows = GrownRows()
        >>> rows.append(torch.zeros(1, 2))
        >>> rows.append(torch.ones(2, 2))
        >>> rows.values
        tensor([[0., 0.],
                [1., 1.],
                [1., 1.]])
    """

    def __init__(self, rows: Tensor | None = None) -> None:
        self._buffer = torch.empty(0) if rows is None else rows.clone()
        self._length = len(self._buffer)

    def __len__(self) -> int:
        return self._length

    @property
    def values(self) -> Tensor:
        """All rows, ``[N, ...]``: a view that the next `append` may leave behind."""
        return self._buffer[: self._length]

    def append(self, rows: Tensor) -> None:
        """Add rows at the end.

        Args:
            rows: ``[A, ...]``.

        Raises:
            ValueError: if they have another shape or dtype than those before.
        """
        if not self._length:
            self._buffer = rows.new_empty(0, *rows.shape[1:])
        kind = (rows.shape[1:], rows.dtype)
        if kind != (self._buffer.shape[1:], self._buffer.dtype):
            raise ValueError(
                f"rows must be {self._buffer.dtype} {list(self._buffer.shape[1:])} as "
                f"those before, got {rows.dtype} {list(rows.shape[1:])}"
            )
        length = self._length + len(rows)
        if length > len(self._buffer):
            more = max(length, 2 * len(self._buffer), 8)
            grown = self._buffer.new_empty(more, *self._buffer.shape[1:])
            grown[: self._length] = self.values
            self._buffer = grown
        self._buffer[self._length : length] = rows
        self._length = length
