"""`ScaledMLP`: layers on inputs that are brought to mean 0 and deviation 1."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

_DROPOUT = 0.1


class ScaledMLP(nn.Module):
    """An `MLP` behind a scaling that `scale_by` takes from examples.

    Args:
        num_inputs: D.
        num_outputs: O.
        hidden: widths of the layers between.

    Shapes:
        float32 ``[*B, D]`` to ``[*B, O]``.

    Examples:
        >>> ScaledMLP(8, 5, [16])(torch.zeros(2, 3, 8)).shape
        torch.Size([2, 3, 5])
    """

    mean: Tensor
    spread: Tensor

    def __init__(
        self, num_inputs: int, num_outputs: int, hidden: Sequence[int]
    ) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(num_inputs))
        self.register_buffer("spread", torch.ones(num_inputs))
        self.layers = MLP(
            num_inputs,
            num_outputs,
            num_cells=list(hidden),
            activation_class=nn.ReLU,
            dropout=_DROPOUT,
        )

    def scale_by(self, inputs: Tensor) -> None:
        """Take mean and deviation of the inputs from examples ``[V, D]``."""
        self.mean.copy_(inputs.mean(0))
        self.spread.copy_(inputs.std(0) + 1e-3)

    def forward(self, inputs: Tensor) -> Tensor:
        outputs: Tensor = self.layers((inputs - self.mean) / self.spread)
        return outputs
