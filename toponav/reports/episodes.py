"""`play_episodes`: policies that are compared play the same episodes."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from tqdm import tqdm

from toponav.builders import Rollout, collect_rollout

# Environments side by side at most.
_MAX_ENVS = 32


def play_episodes(
    make_env: Callable[[int], EnvBase],
    policies: Mapping[str, TensorDictModuleBase],
    episodes: Mapping[str, int],
    decisions: int,
    *,
    seed: int,
    action_seed: int | None = None,
    keep: Sequence[NestedKey],
    keep_next: Sequence[NestedKey],
    views: int,
) -> dict[str, Rollout]:
    """Play whole episodes, with actions sampled as in training.

    Each policy plays so many of the ``episodes`` of T ``decisions`` on what
    ``make_env`` makes, a number of environments side by side. For each, ``seed`` is set
    in the environments, from which their episodes follow, and ``action_seed``, if
    given, for the draws of actions. Frames ``[N, T]`` and what the first environment
    showed, by policy; `collect_rollout` explains the rest.
    """
    envs = min(max(episodes.values()), _MAX_ENVS)
    rounds = {name: math.ceil(episodes[name] / envs) for name in policies}
    total, found = sum(rounds.values()) * envs * decisions, dict[str, Rollout]()
    keys = {"keep": keep, "keep_next": keep_next}
    with closing(make_env(envs)) as env, tqdm(total=total, unit="decision") as bar:
        for name, policy in policies.items():
            bar.set_description(f"evaluate {name}")
            env.set_seed(seed)
            if action_seed is not None:
                torch.manual_seed(action_seed)
            played = [
                collect_rollout(
                    env, policy, decisions, views=views, progress=bar.update, **keys
                )
                for _ in range(rounds[name])
            ]
            frames = torch.cat([one.frames for one in played])[: episodes[name]]
            found[name] = played[0]._replace(frames=frames)
    return found
