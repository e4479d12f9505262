"""`ActionSampler`: one action of each agent from the logits of its controller."""

import torch
from torch import Tensor

# Views count as the same if their embeddings differ by less than this share.
_SAME = 1e-4


class ActionSampler:
    """Draws actions from logits; agents that are lost draw from all alike.

    Drawing, not taking the most probable action, gets an agent out of corners where the
    controller errs. An action that left the view exactly as it was, such as walking
    against a wall, may be left out until the view changes.

    Args:
        temperature: of the softmax; 0 takes the most probable action.
        avoid_futile: whether to leave out actions that changed nothing.
        seed: of the draws.

    Raises:
        ValueError: if ``temperature < 0``.

    Examples:
        >>> sampler = ActionSampler(temperature=0.0)
        >>> sampler.resize(1)
        >>> known = torch.tensor([True])
        >>> sampler.draw(torch.tensor([[0.0, 2.0, 1.0]]), known, torch.ones(1, 4))
        tensor([1])

    Shape notation:
        N: agents.  A: actions.  D: embedding.
    """

    def __init__(
        self, *, temperature: float = 1.0, avoid_futile: bool = False, seed: int = 0
    ) -> None:
        if not temperature >= 0:
            raise ValueError(f"temperature must be at least 0, got {temperature}")
        self.temperature = temperature
        self.avoid_futile = avoid_futile
        self.generator = torch.Generator().manual_seed(seed)
        self.resize(0)

    def resize(self, num_agents: int) -> None:
        """Begin with N agents that have done nothing."""
        self._num_agents = num_agents
        self._last: tuple[Tensor, Tensor] | None = None
        self._futile: Tensor | None = None
        self._new = torch.ones(num_agents, dtype=torch.bool)

    def forget(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, begin a new episode."""
        self._new |= agents

    def draw(self, logits: Tensor, known: Tensor, embedding: Tensor) -> Tensor:
        """One action of each agent, int64 ``[N]``.

        Args:
            logits: float32 ``[N, A]``.
            known: bool ``[N]``; false draws from all actions alike.
            embedding: ``[N, D]``, of the present views.
        """
        logits = torch.where(known.unsqueeze(1), logits, torch.zeros_like(logits))
        if self.avoid_futile:
            logits = logits.masked_fill(
                self._find_futile(logits, embedding), -torch.inf
            )
        sharp = logits / max(self.temperature, 1e-6)
        chance = torch.where(known.unsqueeze(1), sharp, logits).softmax(-1)
        drawn = torch.multinomial(chance, 1, generator=self.generator).squeeze(1)
        if self.temperature == 0:
            drawn = torch.where(known, logits.argmax(1), drawn)
        self._last = (embedding, drawn)
        self._new = torch.zeros_like(self._new)
        return drawn

    def _find_futile(self, logits: Tensor, embedding: Tensor) -> Tensor:
        """Actions that changed nothing since the view last changed, ``[N, A]``."""
        if self._futile is None or self._last is None:
            self._futile = torch.zeros_like(logits, dtype=torch.bool)
            return self._futile
        before, action = self._last
        change = (embedding - before).abs().sum(1)
        same = (change <= _SAME * before.abs().sum(1)) & ~self._new
        self._futile &= same.unsqueeze(1)
        tried = torch.nn.functional.one_hot(action, logits.shape[1]).bool()
        self._futile |= tried & same.unsqueeze(1)
        # Someone for whom nothing changes anything begins anew.
        self._futile &= ~self._futile.all(1, keepdim=True)
        return self._futile
