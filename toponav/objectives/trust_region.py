"""`TrustRegion`: steps along the natural gradient within a bound on a divergence."""

import math
from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn

#: Below this norm a gradient is none: a reward that is the same everywhere.
_NO_GRADIENT = 1e-8


def conjugate_gradient(
    product: Callable[[Tensor], Tensor],
    target: Tensor,
    iterations: int,
    *,
    tolerance: float = 1e-10,
) -> Tensor:
    """The vector whose ``product`` with a symmetric positive matrix is ``target``.

    Ends early when the squared norm of what is left is ``tolerance`` of the target's.

    Examples:
        >>> matrix = torch.tensor([[4.0, 1], [1, 3]])
        >>> conjugate_gradient(matrix.mv, torch.tensor([1.0, 2]), iterations=2)
        tensor([0.0909, 0.6364])
    """
    solution, residual = torch.zeros_like(target), target.clone()
    direction, size = target.clone(), target @ target
    enough = tolerance * float(size)
    for _ in range(iterations):
        if float(size) <= enough:
            break
        image = product(direction)
        rate = size / (direction @ image)
        solution += rate * direction
        residual -= rate * image
        left = residual @ residual
        direction = residual + left / size * direction
        size = left
    return solution


class TrustRegion:
    """Moves weights along the natural gradient as far as a divergence allows.

    The direction solves ``(H + damping) x = -g`` with the gradient ``g`` of a loss and
    the Hessian ``H`` of the divergence (Fisher's information matrix) by conjugate
    gradients. The first step is as long as it may be if the divergence of a step ``x``
    is ``x' (H + damping) x / 2``, and shorter ones are tried until the loss falls and
    the divergence is within its bound. If none is, the weights stay.

    Reference:
        Schulman et al., "Trust Region Policy Optimization" (2015), appendix C.

    Args:
        parameters: the weights.
        max_kl: bound on the divergence, above 0.
        iterations: of conjugate gradients.
        damping: added to the diagonal of H.
        shrink: of each step to the next shorter one, in (0, 1).
        backtracks: number of steps to try.

    Raises:
        ValueError: if a number is out of its range.

    Examples:
        >>> weight = nn.Parameter(torch.tensor([1.0]))
        >>> region = TrustRegion([weight], max_kl=0.02, damping=0.0)
        >>> def evaluate():
        ...     return 3 * weight.sum(), 0.5 * (weight - 1).square().sum()
        >>> round(region.step(evaluate)["kl"], 4)  # 0.16 ** 2 / 2
        0.0128
        >>> weight.detach()  # 0.2, which makes 0.02, is not below it in float32
        tensor([0.8400])
    """

    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        *,
        max_kl: float = 0.01,
        iterations: int = 10,
        damping: float = 0.1,
        shrink: float = 0.8,
        backtracks: int = 15,
    ) -> None:
        rules = {
            "max_kl must be above 0": (max_kl, max_kl > 0),
            "iterations must be at least 1": (iterations, iterations >= 1),
            "damping must be at least 0": (damping, damping >= 0),
            "shrink must be above 0 and below 1": (shrink, 0 < shrink < 1),
            "backtracks must be at least 1": (backtracks, backtracks >= 1),
        }
        for rule, (given, holds) in rules.items():
            if not holds:
                raise ValueError(f"{rule}, got {given}.")
        self.parameters = list(parameters)
        self.max_kl, self.iterations, self.damping = max_kl, iterations, damping
        self.shrink, self.backtracks = shrink, backtracks

    def step(
        self,
        evaluate: Callable[[], tuple[Tensor, Tensor]],
        curvature: Callable[[], Tensor] | None = None,
    ) -> dict[str, float]:
        """Move the weights once.

        Args:
            evaluate: returns the loss and the divergence from the weights as they were
                when `step` was called, both with gradients.
            curvature: returns the divergence that H is taken of, such as of fewer
                decisions; that of ``evaluate``, called once more, unless given.

        Returns:
            ``loss`` and ``kl`` after the step, ``loss_before``, and ``step``, the share
            of the longest step that was taken: 0 if the weights stayed, as they do
            where the gradient is zero or not finite.
        """
        loss, _ = evaluate()
        gradient = self._gradient(loss)
        before = float(loss.detach())
        stayed = {"loss_before": before, "loss": before, "kl": 0.0, "step": 0.0}
        # NaN is not above anything.
        if not _NO_GRADIENT < float(gradient.norm()) < math.inf:
            return stayed
        # cuDNN's LSTM has no second derivative.
        with torch.backends.cudnn.flags(enabled=False):
            curved = curvature() if curvature else evaluate()[1]
        slope = self._gradient(curved, create_graph=True)

        def product(vector: Tensor) -> Tensor:
            image = self._gradient(slope @ vector)
            return image + self.damping * vector

        direction = conjugate_gradient(product, -gradient, self.iterations)
        length = (2 * self.max_kl / (direction @ product(direction))).sqrt()
        start = torch.cat([one.detach().reshape(-1) for one in self.parameters])
        for number in range(self.backtracks):
            share = self.shrink**number
            self._assign(start + share * length * direction)
            with torch.no_grad():
                loss, kl = evaluate()
            if float(loss) < before and float(kl) <= self.max_kl:
                after = {"loss": float(loss), "kl": float(kl), "step": share}
                return stayed | after
        self._assign(start)
        return stayed

    def _gradient(self, value: Tensor, *, create_graph: bool = False) -> Tensor:
        found = torch.autograd.grad(
            value,
            self.parameters,
            retain_graph=True,
            create_graph=create_graph,
            allow_unused=True,
        )
        pairs = zip(found, self.parameters, strict=True)
        return torch.cat(
            [
                (torch.zeros_like(one) if gradient is None else gradient).reshape(-1)
                for gradient, one in pairs
            ]
        )

    @torch.no_grad()
    def _assign(self, weights: Tensor) -> None:
        pieces = weights.split([one.numel() for one in self.parameters])
        for piece, one in zip(pieces, self.parameters, strict=True):
            one.copy_(piece.view_as(one))
