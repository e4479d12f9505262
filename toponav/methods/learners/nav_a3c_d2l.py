"""Nav A3C + D2L: the memory must also tell depth, and whether a loop has closed.

Depth and loops are ground truth. The losses read them while the policy is trained; the
policy that acts does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.envs.transforms import Transform

from toponav.builders import World
from toponav.config import ExploreConfig, above, at_least, require
from toponav.keys import DEPTH, LOOP_CLOSED, read_entry
from toponav.methods.learners.nav_a3c import NavA3CConfig, NavA3CLearner
from toponav.modules import NEXT_HIDDEN, NavActorCritic
from toponav.objectives import A3CLoss
from toponav.transforms import LoopClosure

# Rows and columns of the picture that is told, and the bounds between its classes.
_ROWS, _COLUMNS = 4, 16
_BOUNDS = (0.05, 0.175, 0.3, 0.425, 0.55, 0.675, 0.8)
# Share of a depth picture's height and width that is left out on each side.
_CROP = (0.2, 0.05)
# Width of the layer of either head.
_HIDDEN = 2**7


@dataclass
class NavA3CD2LConfig(NavA3CConfig):
    """Settings of ``loss=nav_a3c_d2l``."""

    depth_coeff: float = at_least(0)
    loop_coeff: float = at_least(0)
    near: float = above(0)
    far: float = above(0)

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = f"loss.far must be more than loss.near={self.near:g}"
        require(self.far > self.near, rule, f"{self.far:g}")


def depth_classes(depth: Tensor, *, cell_size: float) -> Tensor:
    """Which of eight classes the depth is in, at 4 x 16 places of the middle.

    Classes are by ``depth / (depth + cell_size)``, which is 1/2 at the distance of a
    cell; those of the authors are by the tenth power of DeepMind Lab's depth.

    Args:
        depth: float32 ``[*B, H, W]`` in map units.
        cell_size: side of a cell in map units.

    Returns:
        int64 ``[*B, 64]`` in [0, 8).

    Examples:
        >>> near, far = torch.full((20, 18), 10.0), torch.full((20, 18), 1000.0)
        >>> classes = depth_classes(torch.stack([near, far]), cell_size=100.0)
        >>> classes.shape, classes.unique(dim=1).flatten()
        (torch.Size([2, 64]), tensor([1, 7]))
    """
    *batch, height, width = depth.shape
    top, left = round(_CROP[0] * height), round(_CROP[1] * width)
    middle = depth[..., top : height - top, left : width - left]
    middle = middle.reshape(-1, 1, *middle.shape[-2:])
    small = F.adaptive_avg_pool2d(middle, (_ROWS, _COLUMNS)).reshape(*batch, -1)
    share = small / (small + cell_size)
    return torch.bucketize(share, torch.tensor(_BOUNDS).to(share.device))


class NavigationHeads(nn.Module):
    """What the memory's output ``[*B, H]`` says of depth and loops, as logits.

    Examples:
        >>> depth, loop = NavigationHeads(256)(torch.zeros(5, 256))
        >>> depth.shape, loop.shape
        (torch.Size([5, 64, 8]), torch.Size([5, 1]))
    """

    def __init__(self, hidden_dim: int) -> None:
        super().__init__()
        places, classes = _ROWS * _COLUMNS, len(_BOUNDS) + 1
        self.depth = nn.Sequential(
            nn.Linear(hidden_dim, _HIDDEN),
            nn.ReLU(),
            nn.Linear(_HIDDEN, places * classes),
            nn.Unflatten(-1, (places, classes)),
        )
        self.loop = nn.Sequential(
            nn.Linear(hidden_dim, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, 1)
        )

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        return self.depth(output), self.loop(output)


class NavA3CD2LLoss(A3CLoss):
    """`A3CLoss` and what the heads get wrong, from one pass of the network.

    ``loss_depth`` is ``depth_coeff`` times the mean cross-entropy over the places,
    ``loss_loop`` is ``loop_coeff`` times that of the loops; both are reduced like the
    others. Beside the losses come, of this batch: ``depth_accuracy``, and
    ``depth_chance``, that of the most frequent class at each place; ``loop_share`` of
    loops, ``loop_found`` of them that are told, and ``loop_false``, the share of what
    is told a loop among the rest.

    Args:
        actor_network: of Nav A3C.
        heads: those of depth and loops.
        cell_size: side of a cell in map units.
        depth_coeff, loop_coeff: weights of the two losses.
    """

    out_keys = [*A3CLoss.out_keys, "loss_depth", "loss_loop"]

    def __init__(
        self,
        actor_network: NavActorCritic,
        heads: NavigationHeads,
        *,
        cell_size: float,
        depth_coeff: float,
        loop_coeff: float,
    ) -> None:
        super().__init__(actor_network)
        self.heads = heads
        self.cell_size = cell_size
        self.depth_coeff, self.loop_coeff = depth_coeff, loop_coeff

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        unrolled = self.actor_network.unroll(tensordict)
        found = self._losses(tensordict, *self._evaluate_unrolled(tensordict, unrolled))
        depth, loop = self.heads(unrolled[NEXT_HIDDEN])
        classes = depth_classes(read_entry(tensordict, DEPTH), cell_size=self.cell_size)
        closed = read_entry(tensordict, LOOP_CLOSED)
        logits = depth.flatten(0, -2)
        wrong = F.cross_entropy(logits, classes.flatten(), reduction="none")
        missed = F.binary_cross_entropy_with_logits(
            loop, closed.to(loop.dtype), reduction="none"
        )
        losses = {
            "loss_depth": self.depth_coeff * wrong.reshape(classes.shape).mean(-1),
            "loss_loop": self.loop_coeff * missed.squeeze(-1),
        }
        for name, loss in losses.items():
            found[name] = self._reduce(loss, tensordict)
        return found.update(judge_heads(depth.detach(), classes, loop.detach(), closed))


def judge_heads(
    depth: Tensor, classes: Tensor, loop: Tensor, closed: Tensor
) -> dict[str, Tensor]:
    """How well the heads do, as `NavA3CD2LLoss` names it; NaN where nothing is judged.

    Args:
        depth: logits ``[*B, 64, 8]``.
        classes: int64 ``[*B, 64]``.
        loop: logits ``[*B, 1]``.
        closed: bool ``[*B, 1]``.
    """
    places = classes.shape[-1]
    counts = F.one_hot(classes.reshape(-1, places), depth.shape[-1]).sum(0)
    said = loop > 0
    return {
        "depth_accuracy": (depth.argmax(-1) == classes).float().mean(),
        "depth_chance": counts.amax(-1).sum() / counts.sum(),
        "loop_share": closed.float().mean(),
        "loop_found": said[closed].float().mean(),
        "loop_false": said[~closed].float().mean(),
    }


class NavA3CD2LLearner(NavA3CLearner):
    """Nav A3C with two auxiliary tasks: depth from the memory, and loop closure.

    Reference:
        Mirowski et al., "Learning to Navigate in Complex Environments" (2016).
    """

    schema = NavA3CD2LConfig
    config: NavA3CD2LConfig
    taught = ("depth",)
    saved: Sequence[str] = (*NavA3CLearner.saved, "heads")
    losses = (*NavA3CLearner.losses, "loss_depth", "loss_loop")
    logged = (
        *(*NavA3CLearner.logged, "depth_accuracy", "depth_chance"),
        *("loop_share", "loop_found", "loop_false"),
    )

    def __init__(self, settings: ExploreConfig, world: World, **given: Any) -> None:
        assert world.spec.motion is not None, "worlds with a depth have a motion"
        self.cell_size = world.spec.motion.cell_size
        super().__init__(settings, world, **given)
        self.in_keys = [*self.in_keys, DEPTH, LOOP_CLOSED]

    @staticmethod
    def make_transforms(settings: ExploreConfig, world: World) -> list[Transform]:
        loss, motion = settings.loss, world.spec.motion
        assert isinstance(loss, NavA3CD2LConfig)
        assert motion is not None, "worlds with a depth have a motion"
        near, far = (cells * motion.cell_size for cells in (loss.near, loss.far))
        return [LoopClosure(near=near, far=far)]

    def parameters(self) -> list[nn.Parameter]:
        return [*self.policy.parameters(), *self.heads.parameters()]

    def make_loss(self) -> NavA3CD2LLoss:
        policy = self.policy
        assert isinstance(policy, NavActorCritic)
        self.heads = NavigationHeads(policy.hidden_dim).to(self.device)
        return NavA3CD2LLoss(
            policy,
            self.heads,
            cell_size=self.cell_size,
            depth_coeff=self.config.depth_coeff,
            loop_coeff=self.config.loop_coeff,
        )
