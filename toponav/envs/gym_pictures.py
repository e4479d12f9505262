"""`GymChoices` and `make_gym_env`: one Gymnasium environment that shows pictures."""

import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import (
    AddRenderObservation,
    TransformAction,
    TransformObservation,
)

GymEnv = gymnasium.Env[Any, Any]
#: A wrapper, or the import path of one.
Wrapper = str | Callable[[GymEnv], GymEnv]

#: How the ids of worlds begin that the extra ``worlds`` installs, and the module that
#: registers them.
_MODULES = {"MiniGrid-": "minigrid", "BabyAI-": "minigrid"}
_MODULES |= {"MiniWorld-": "miniworld", "ALE/": "ale_py"}


@dataclass(frozen=True, kw_only=True)
class GymChoices:
    """What is done with a Gymnasium environment before anybody sees it.

    Examples:
        >>> GymChoices(position=("agent_pos.0", "agent_pos.1")).square
        1.0
    """

    render: bool = False  # whether views are what it renders
    options: Mapping[str, Any] = field(default_factory=dict)  # for gymnasium.make
    wrappers: Sequence[Wrapper] = ()  # the innermost first
    view: str | None = None  # entry of a dictionary that is the view
    actions: Sequence[int] = ()  # numbers of those to use; none for all
    reset_seed: int | None = None  # of every reset; ``None`` draws them
    #: Where to find x and y, for reports alone; none if it has no position.
    position: Sequence[str] = ()
    square: float = 1.0  # side of what counts as one place


def make_gym_env(id: str, choices: GymChoices) -> tuple[GymEnv, tuple[str, ...]]:
    """An environment with views, uint8 ``[H, W, 3]``, and the names of its actions.

    Raises:
        ValueError: if it is unknown, or does not fit.
    """
    env = _make(id, choices)
    try:
        for wrapper in choices.wrappers:
            env = _wrap(env, wrapper)
        env = _show_pictures(id, env, choices)
        env, actions = _choose_actions(id, env, choices.actions)
        if choices.position:
            if len(choices.position) != 2:
                got = list(choices.position)
                raise ValueError(f"position must be of two numbers, x and y, got {got}")
            _, info = env.reset(seed=0)
            read_position(env, info, choices.position)
    except BaseException:
        env.close()
        raise
    return env, actions


def read_position(
    env: GymEnv, info: Mapping[str, Any], paths: Sequence[str]
) -> list[float]:
    """The numbers to which dotted paths lead.

    A path begins with an entry of ``info``, or an attribute of the environment, and a
    number in it picks an entry.

    Raises:
        ValueError: if a path leads to no number.
    """
    found = []
    for path in paths:
        first, *rest = path.split(".")
        try:
            value = info[first] if first in info else getattr(env.unwrapped, first)
            for part in rest:
                if part.isdigit():
                    value = value[int(part)]
                else:
                    is_mapping = isinstance(value, Mapping)
                    value = value[part] if is_mapping else getattr(value, part)
            found.append(float(value))
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            rule = "position must lead to numbers of info or of the environment"
            raise ValueError(f"{rule}, got '{path}': {error}") from error
    return found


def _make(id: str, choices: GymChoices) -> GymEnv:
    # Some environments take no render_mode.
    options = {"render_mode": "rgb_array"} if choices.render else {}
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        # MiniWorld asks for a window as soon as it is imported, unless this is set.
        os.environ.setdefault("PYGLET_HEADLESS", "true")
    modules = [name for begin, name in _MODULES.items() if id.startswith(begin)]
    try:
        name = ":".join([*modules, id])
        return gymnasium.make(name, **{**options, **choices.options})
    # Engines of others fail in ways of their own, without a display for example.
    except Exception as error:
        said = str(error).strip().splitlines() or [type(error).__name__]
        got = f"'{id}': {said[0]}"
        missing = getattr(error.__cause__ or error, "name", None)
        if missing in _MODULES.values():
            got += " (did you pip install 'toponav[worlds]'?)"
        raise ValueError(f"id must name a Gymnasium environment, got {got}") from error


def _wrap(env: GymEnv, wrapper: Wrapper) -> GymEnv:
    name, make = wrapper, wrapper
    if isinstance(wrapper, str):
        module, _, attribute = wrapper.rpartition(".")
        try:
            make = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            rule = "wrappers must be import paths such as package.module.Wrapper"
            raise ValueError(f"{rule}, got '{wrapper}': {error}") from error
    try:
        assert callable(make)
        wrapped = make(env)
    except Exception as error:
        got = f"{name}: {error or type(error).__name__}"
        raise ValueError(f"wrappers must fit the environment, got {got}") from error
    if not isinstance(wrapped, gymnasium.Env):
        raise ValueError(f"wrappers must return an environment, got that of {name}")
    return wrapped


def _show_pictures(id: str, env: GymEnv, choices: GymChoices) -> GymEnv:
    if choices.render:
        try:
            env = AddRenderObservation(env)
        except (TypeError, ValueError) as error:
            message = f"'{id}' must render a picture [H, W, 3], got {error}"
            raise ValueError(message) from error
    space, wanted = env.observation_space, choices.view
    if wanted is None and _is_picture(space):
        return env
    entries = space.spaces if isinstance(space, spaces.Dict) else {}
    keys = [key for key, entry in entries.items() if _is_picture(entry)]
    if wanted is not None and wanted not in keys:
        got = f"'{wanted}' of {', '.join(entries) or 'no dictionary'}"
        rule = f"view must name a uint8 picture [H, W, 3] in what '{id}' observes"
        raise ValueError(f"{rule}, got {got}")
    if wanted is None and len(keys) != 1:
        raise ValueError(
            f"the observation of '{id}' must be or hold one uint8 picture [H, W, 3] "
            "(render=True takes what it renders, view=<key> picks one, and a wrapper "
            f"may make one), got {space}"
        )
    key = wanted or keys[0]
    return TransformObservation(env, itemgetter(key), entries[key])


def _is_picture(space: spaces.Space[Any]) -> bool:
    shape = space.shape or ()
    return space.dtype == np.uint8 and len(shape) == 3 and shape[-1] == 3


def _choose_actions(
    id: str, env: GymEnv, chosen: Sequence[int]
) -> tuple[GymEnv, tuple[str, ...]]:
    """An environment whose actions are numbers from 0, and their names."""
    space = env.action_space
    if not isinstance(space, spaces.Discrete):
        raise ValueError(f"the actions of '{id}' must be discrete, got {space}")
    names = [f"action {number}" for number in range(int(space.n))]
    meanings = list(getattr(env.unwrapped, "get_action_meanings", list)())
    if len(meanings) == len(names):  # a wrapper may have left some of them out
        names = meanings
    used = list(chosen) or list(range(len(names)))
    if min(used) < 0 or max(used) >= len(names) or len(set(used)) < max(len(used), 2):
        rule = f"actions must be two or more different ones of 0 to {len(names) - 1}"
        raise ValueError(f"{rule}, got {used}")
    first = int(space.start)
    if chosen or first:
        numbers = [first + number for number in used]
        chosen_space = spaces.Discrete(len(used))
        env = TransformAction(env, numbers.__getitem__, chosen_space)
    return env, tuple(names[number] for number in used)
