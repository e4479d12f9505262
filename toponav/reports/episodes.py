"""`play_episodes`: policies that are compared play the same episodes."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from tqdm import tqdm

from toponav.builders import Rollout, collect_rollout

# Environments side by side at most.
_MAX_ENVS = 32
#: Called with the name of the policy that plays, and the decisions of all policies so
#: far and in all.
Progress = Callable[[str, int, int], object]


class PlayingBar:
    """One line of progress for the episodes of all policies; none before the first."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._name = ""

    def __call__(self, name: str, done: int, total: int) -> None:
        """Show how far they are."""
        if self._bar is None:
            self._bar = tqdm(total=total, unit="decision")
        if name != self._name:
            self._name = name
            self._bar.set_description(f"evaluate {name}")
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Leave the line as it is."""
        if self._bar is not None:
            self._bar.close()


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
    progress: Progress | None = None,
) -> dict[str, Rollout]:
    """Play whole episodes, with actions sampled as in training.

    Each policy plays so many of the ``episodes`` of T ``decisions`` on what
    ``make_env`` makes, a number of environments side by side. For each, ``seed`` is set
    in the environments, from which their episodes follow, and ``action_seed``, if
    given, for the draws of actions. Frames ``[N, T]`` and what the first environment
    showed, by policy; `collect_rollout` explains the rest. Without ``progress`` a line
    shows it.
    """
    envs = min(max(episodes.values()), _MAX_ENVS)
    rounds = {name: math.ceil(episodes[name] / envs) for name in policies}
    total, found = sum(rounds.values()) * envs * decisions, dict[str, Rollout]()
    keys = {"keep": keep, "keep_next": keep_next}
    done = 0
    with closing(make_env(envs)) as env, closing(PlayingBar()) as bar:
        show = progress or bar
        for name, policy in policies.items():

            def count(more: int, name: str = name) -> None:
                nonlocal done
                done += more
                show(name, done, total)

            count(0)
            env.set_seed(seed)
            if action_seed is not None:
                torch.manual_seed(action_seed)
            played = [
                collect_rollout(
                    env, policy, decisions, views=views, progress=count, **keys
                )
                for _ in range(rounds[name])
            ]
            frames = torch.cat([one.frames for one in played])[: episodes[name]]
            found[name] = played[0]._replace(frames=frames)
    return found
