"""`Odometry`: how far the agent got by an action, by the views before and after."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.modules import MLP

#: Of the layers between.
_WIDTHS = 2**7, 2**6
#: Steps in an update.
_BATCH = 512
#: Steps of length at which the loss turns from a square to an absolute value.
_BETA = 0.1


class Odometry:
    """Learns steps from what positions say of them, and smooths these.

    A wall stops the agent or makes it slide, and the views show it. Positions that fit
    all views of a place say how far each step led, with much noise; a perceptron on the
    embeddings before and after, the action and the one before it learns the mean of
    that.

    Args:
        before, after: embeddings of the two views of each of N steps, ``[N, D]``.
        actions: what was done between them and before the first, int64 ``[N, 2]``.
        num_actions: A.
        updates: of the network at each `fit`.
    """

    def __init__(
        self,
        before: Tensor,
        after: Tensor,
        actions: Tensor,
        num_actions: int,
        *,
        updates: int,
        seed: int = 0,
    ) -> None:
        seen = torch.cat([before, after - before], 1).float()
        spread = seen.std(0, keepdim=True) + 1e-3
        done = F.one_hot(actions, num_actions).flatten(1).float()
        self._inputs = torch.cat(
            [(seen - seen.mean(0, keepdim=True)) / spread, done], 1
        )
        self._updates, self._seed = updates, seed

    @torch.enable_grad()
    def fit(self, steps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Steps ``[N, 2]``, ahead and to the left, smoothed by a network of its own."""
        wanted = torch.from_numpy(steps).float()
        # The draws of the caller stay as they are.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self._seed)
            net = MLP(
                self._inputs.shape[1], 2, num_cells=_WIDTHS, activation_class=nn.ReLU
            )
            optimizer = torch.optim.AdamW(net.parameters(), lr=1e-3, weight_decay=3e-2)
            for _ in range(self._updates):
                drawn = torch.randint(len(wanted), (_BATCH,))
                found = net(self._inputs[drawn])
                loss = F.smooth_l1_loss(found, wanted[drawn], beta=_BETA)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
        with torch.no_grad():
            smoothed: NDArray[np.float64] = net(self._inputs).double().numpy()
        return smoothed
