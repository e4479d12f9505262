"""`ActionSampler`: one action of each agent from the logits of its controller."""

import torch
from torch import Tensor

from toponav.graph.rules import NavigatorRules

# Views count as the same if their embeddings differ by less than this share.
_SAME = 1e-4


class ActionSampler:
    """Draws actions of N agents from logits; agents that are lost draw uniformly."""

    def __init__(
        self, num_agents: int, rules: NavigatorRules, generator: torch.Generator
    ) -> None:
        self.rules = rules
        self.generator = generator
        #: int64 ``[N]``, the last one that each did; 0 before the first.
        self.last_action = torch.zeros(num_agents, dtype=torch.int64)
        # Of the view that it was drawn at.
        self._before: Tensor | None = None
        self._noops = torch.empty(0)
        self._is_new = torch.ones(num_agents, dtype=torch.bool)

    def forget(self, agents: Tensor) -> None:
        """The views before these, of agents bool ``[N]``, were taken elsewhere."""
        self._is_new |= agents

    def draw(self, logits: Tensor, known: Tensor, embedding: Tensor) -> Tensor:
        """One action of each agent by its logits ``[N, A]``; if not ``known``, any."""
        logits = logits.masked_fill(~known.unsqueeze(1), 0.0)
        if self.rules.mask_noop_actions:
            noops = self._find_noops(logits, embedding)
            logits = logits.masked_fill(noops, -torch.inf)
        chance = (logits / max(self.rules.temperature, 1e-6)).softmax(-1)
        drawn = torch.multinomial(chance, 1, generator=self.generator).squeeze(1)
        if self.rules.temperature == 0:
            drawn = torch.where(known, logits.argmax(1), drawn)
        self._before, self.last_action = embedding, drawn
        self._is_new = torch.zeros_like(self._is_new)
        return drawn

    def _find_noops(self, logits: Tensor, embedding: Tensor) -> Tensor:
        """Actions that changed nothing since the view last changed, ``[N, A]``."""
        if self._before is None:
            self._noops = torch.zeros_like(logits, dtype=torch.bool)
            return self._noops
        before, action = self._before, self.last_action
        change = (embedding - before).abs().sum(1)
        same = (change <= _SAME * before.abs().sum(1)) & ~self._is_new
        tried = torch.nn.functional.one_hot(action, logits.shape[1]).bool()
        self._noops = (self._noops | tried) & same.unsqueeze(1)
        # If nothing changes the view, all actions are allowed again.
        self._noops &= ~self._noops.all(1, keepdim=True)
        return self._noops
