"""`ActionSampler`: one action of each agent from the logits of its controller."""

import torch
from torch import Tensor

# Views count as the same if their embeddings differ by less than this share.
_SAME = 1e-4


class ActionSampler:
    """Draws actions from logits; agents that are lost draw uniformly.

    Drawing, not taking the most probable action, gets an agent out of corners where the
    controller errs. An action that left the view exactly as it was may be masked until
    the view changes. See `NavigatorRules` for the arguments.
    """

    def __init__(
        self,
        *,
        temperature: float = 1.0,
        mask_noop_actions: bool = False,
        seed: int = 0,
    ) -> None:
        self.temperature = temperature
        self.mask_noop_actions = mask_noop_actions
        self.generator = torch.Generator().manual_seed(seed)
        self.resize(0)

    def resize(self, num_agents: int) -> None:
        self._last: tuple[Tensor, Tensor] | None = None
        self._noops: Tensor | None = None
        self._is_new = torch.ones(num_agents, dtype=torch.bool)

    def forget(self, agents: Tensor) -> None:
        self._is_new |= agents

    def draw(self, logits: Tensor, known: Tensor, embedding: Tensor) -> Tensor:
        """One action of each agent by its logits ``[N, A]``; if not ``known``, any."""
        logits = torch.where(known.unsqueeze(1), logits, torch.zeros_like(logits))
        if self.mask_noop_actions:
            noops = self._find_noops(logits, embedding)
            logits = logits.masked_fill(noops, -torch.inf)
        sharp = logits / max(self.temperature, 1e-6)
        chance = torch.where(known.unsqueeze(1), sharp, logits).softmax(-1)
        drawn = torch.multinomial(chance, 1, generator=self.generator).squeeze(1)
        if self.temperature == 0:
            drawn = torch.where(known, logits.argmax(1), drawn)
        self._last = (embedding, drawn)
        self._is_new = torch.zeros_like(self._is_new)
        return drawn

    def _find_noops(self, logits: Tensor, embedding: Tensor) -> Tensor:
        """Actions that changed nothing since the view last changed, ``[N, A]``."""
        if self._noops is None or self._last is None:
            self._noops = torch.zeros_like(logits, dtype=torch.bool)
            return self._noops
        before, action = self._last
        change = (embedding - before).abs().sum(1)
        same = (change <= _SAME * before.abs().sum(1)) & ~self._is_new
        self._noops &= same.unsqueeze(1)
        tried = torch.nn.functional.one_hot(action, logits.shape[1]).bool()
        self._noops |= tried & same.unsqueeze(1)
        # If nothing changes the view, all actions are allowed again.
        self._noops &= ~self._noops.all(1, keepdim=True)
        return self._noops
