"""`SteeringSenses`: what an agent that practises steering reads beside its view."""

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from toponav.graph.navigation.path_following import aim_along

#: Steps along the path to the points that it senses, and what counts as 1 of them.
_AHEAD, _SCALE = (1.0, 2.0, 3.5, 5.0, 7.0), 4.0
#: Decisions by which actions may seem worse than the best one, at most.
_WORST = 2.0


class SteeringSenses:
    """Where the path leads, seen from each of N agents, and how it has fared just now.

    S numbers: points of its path at several distances and the one that it aims at, each
    ahead and to the left; whether its path ends there; its last action; how far its
    pose and its view changed since; how sure it is of its pose; how much worse each
    action seems than the best one in free space. In a first decision it has moved as
    far as counts, its view is all new, and there is no last action.

    Args:
        num_agents: N.
        num_actions: A.
        embedding_size: numbers of a view's embedding, D.
    """

    def __init__(self, num_agents: int, num_actions: int, embedding_size: int) -> None:
        self.num_actions = num_actions
        # In the decision before; infinite in a first one.
        self._position = torch.full((num_agents, 2), torch.inf)
        self._seen = torch.zeros(num_agents, embedding_size)

    @staticmethod
    def size(num_actions: int) -> int:
        """S.

        Examples:
            >>> SteeringSenses.size(6)  # 2 * (5 + 1) + 1 + 6 + 3 + 6
            28
        """
        return 2 * (len(_AHEAD) + 1) + 1 + num_actions + 3 + num_actions

    def forget(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, have been put elsewhere."""
        self._position[agents], self._seen[agents] = torch.inf, 0

    def __call__(
        self,
        pose: Tensor,
        spread: Tensor,
        path: Tensor,
        aim: Tensor,
        ends: Tensor,
        action: Tensor,
        embedding: Tensor,
        free: Tensor,
    ) -> Tensor:
        """Sense once in each decision.

        Args:
            pose: steps, steps and degrees, ``[N, 3]``.
            spread: deviation of the poses that an agent may have, in steps, ``[N]``.
            path: its next waypoints, ``[N, L, 2]``.
            aim: the point that it aims at, ``[N, 2]``.
            ends: bool ``[N]``, whether its path ends there.
            action: the last one, int64 ``[N]``.
            embedding: of its view, ``[N, D]``.
            free: logits of the actions in free space, ``[N, A]``.

        Returns:
            float32 ``[N, S]``.
        """
        position = pose[:, :2]
        points = [aim_along(position, path, ahead=ahead).point for ahead in _AHEAD]
        gaps = torch.stack([*points, aim], 1) - position.unsqueeze(1)
        cos, sin = pose[:, 2:].deg2rad().cos(), pose[:, 2:].deg2rad().sin()
        ahead = gaps[..., 0] * cos + gaps[..., 1] * sin
        left = gaps[..., 1] * cos - gaps[..., 0] * sin
        moved = (position - self._position).norm(dim=1)
        length = embedding.norm(dim=1).clamp(min=1e-6)
        changed = (embedding - self._seen).norm(dim=1) / length
        is_first = self._position.isinf().any(1, keepdim=True)
        self._position, self._seen = position.clone(), embedding.clone()
        felt = torch.stack([ends.float(), moved, changed, spread], 1).clamp(max=2)
        worse = (free - free.amax(1, keepdim=True)).clamp(min=-_WORST)
        where = (torch.cat([ahead, left], 1) / _SCALE).clamp(-2, 2)
        last = one_hot(action, self.num_actions).masked_fill(is_first, 0)
        return torch.cat([where, felt, last, worse], 1)
