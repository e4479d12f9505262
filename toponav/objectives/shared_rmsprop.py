"""`SharedRMSProp`: the optimiser of asynchronous actor-critics."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor


class SharedRMSProp(torch.optim.Optimizer):
    """Non-centred RMSProp with the constant inside the root, ready to be shared.

    ``g <- decay g + (1 - decay) grad^2`` and ``theta <- theta - lr grad / sqrt(g +
    eps)``. The mean squares ``g`` exist from the start and stay where they are:
    `share_memory` lets other processes update them.

    Reference:
        The paper, eqs. 3 and 4; Mnih et al., "Asynchronous Methods for Deep
        Reinforcement Learning" (2016), which shares ``g`` among the workers.

    Examples:
        >>> weight = torch.nn.Parameter(torch.tensor([1.0]))
        >>> optimizer = SharedRMSProp([weight], lr=0.1, decay=0.99, eps=0.01)
        >>> (2 * weight).sum().backward()
        >>> optimizer.step()  # 1 - 0.1 * 2 / sqrt(0.01 * 2**2 + 0.01)
        >>> round(weight.item(), 4)
        0.1056
    """

    def __init__(
        self,
        params: Iterable[Tensor] | Iterable[dict[str, Any]],
        lr: float = 7e-4,
        *,
        decay: float = 0.99,
        eps: float = 0.1,
    ) -> None:
        if lr < 0:
            raise ValueError(f"lr must not be negative, got {lr}.")
        if not 0 <= decay < 1:
            raise ValueError(f"decay must be at least 0 and below 1, got {decay}.")
        if eps <= 0:
            raise ValueError(f"eps must be above 0, got {eps}.")
        super().__init__(params, {"lr": lr, "decay": decay, "eps": eps})

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add a group, as torch has it, with mean squares of its own."""
        super().add_param_group(param_group)
        for parameter in self.param_groups[-1]["params"]:
            self.state[parameter]["mean_square"] = torch.zeros_like(parameter)

    def share_memory(self) -> "SharedRMSProp":
        """Share the mean squares of all groups so far; do so before processes start."""
        for state in self.state.values():
            state["mean_square"].share_memory_()
        return self

    @torch.no_grad()
    def step(  # type: ignore[override]
        self, closure: Callable[[], float] | None = None
    ) -> float | None:
        """Update the parameters that have a gradient; ``closure`` as torch has it."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            params = [p for p in group["params"] if p.grad is not None]
            if not params:
                continue
            grads = [p.grad for p in params]
            squares = [self.state[p]["mean_square"] for p in params]
            torch._foreach_mul_(squares, group["decay"])
            torch._foreach_addcmul_(squares, grads, grads, 1 - group["decay"])
            roots = torch._foreach_add(squares, group["eps"])
            torch._foreach_sqrt_(roots)
            torch._foreach_addcdiv_(params, grads, roots, -group["lr"])
        return loss

    @torch.no_grad()
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Load a `state_dict` into the existing, perhaps shared, mean squares."""
        own = {p: state["mean_square"] for p, state in self.state.items()}
        super().load_state_dict(state_dict)
        for parameter, mean_square in own.items():
            mean_square.copy_(self.state[parameter]["mean_square"])
            self.state[parameter]["mean_square"] = mean_square
