"""`GrowingRows`: a tensor to which rows are added, in memory that doubles."""

from torch import Tensor


class GrowingRows:
    """Rows ``[N, *S]``; one more is written beside them, and they are seldom copied.

    Where there is no room left, memory for twice as many is taken, so that N rows cost
    at most 2 N copies of a row in all, where ``torch.cat`` costs N^2 / 2.

    Args:
        rows: the first ones, ``[N, *S]``; of none, the first row says the shape.

    Examples:
        >>> import torch
        >>> grown = GrowingRows(torch.tensor([[1.0, 2.0]]))
        >>> before = grown.rows
        >>> grown.append(torch.tensor([3.0, 4.0]))
        >>> grown.rows.tolist(), before.tolist()
        ([[1.0, 2.0], [3.0, 4.0]], [[1.0, 2.0]])
    """

    def __init__(self, rows: Tensor) -> None:
        self._memory, self._number = rows, len(rows)

    @property
    def rows(self) -> Tensor:
        """A view of the rows, which later ones do not change."""
        return self._memory[: self._number]

    def append(self, row: Tensor) -> None:
        """Add a row ``[*S]``."""
        if self._number == len(self._memory):
            memory = self.rows.new_empty(max(2 * self._number, 1), *row.shape)
            if self._number:
                memory[: self._number] = self.rows
            self._memory = memory
        self._memory[self._number] = row
        self._number += 1
