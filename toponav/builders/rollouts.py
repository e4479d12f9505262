"""`collect_rollout`: play a policy in a batch of environments."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from toponav.keys import PIXELS


class Rollout(NamedTuple):
    """Decisions of a policy."""

    #: ``[E, T]`` with the keys that were asked for.
    frames: TensorDictBase
    #: ``[]``; all entries of the first environment after its reset.
    start: TensorDictBase
    #: ``[V, H, W, 3]``; the first views of the first environment.
    views: Tensor


@torch.no_grad()
def collect_rollout(
    env: EnvBase,
    policy: TensorDictModuleBase,
    decisions: int,
    *,
    keep: Sequence[NestedKey],
    keep_next: Sequence[NestedKey] = (),
    views: int = 0,
    progress: Callable[[int], object] | None = None,
) -> Rollout:
    """Reset the environments and play; actions are sampled, as in training.

    Where an episode ends, the next one follows.

    Args:
        env: of batch size ``[E]``.
        policy: reads what the environment writes.
        decisions: number T of decisions.
        keep: keys to keep of the moment of each decision; missing ones are skipped.
        keep_next: keys to keep of the moment after it, under ``next``; likewise.
        views: number V of views to keep of the first environment, at most T + 1.
        progress: called with E after every decision.
    """
    frames: list[TensorDictBase] = []
    seen: list[Tensor] = []
    with set_exploration_type(ExplorationType.RANDOM):
        now = env.reset()
        start = now[0].clone()
        for _ in range(decisions):
            step, following = env.step_and_maybe_reset(policy(now))
            frame = step.select(*keep, strict=False)
            if keep_next:
                frame["next"] = step["next"].select(*keep_next, strict=False)
            frames.append(frame)
            if len(seen) < views:
                seen.append(step[PIXELS][0].clone())
            now = following
            if progress is not None:
                progress(env.batch_size[0])
        if len(seen) < views:
            seen.append(step["next", PIXELS][0].clone())
    shown = torch.stack(seen) if seen else torch.empty(0)
    return Rollout(torch.stack(frames, 1), start, shown)
