"""From batches to pieces of episodes: what one environment saw without a break."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor

from toponav import keys
from toponav.actions import as_numbers
from toponav.graph.waypoints import Embed, check_finite


@dataclass(frozen=True)
class MapKeys:
    """The keys that `TopologicalMap` reads of a batch; see its ``set_keys``."""

    embedding: NestedKey = keys.EMBEDDING  # float [D]
    #: uint8 ``[H, W, C]``, or as the map's ``channels`` say; only needed where
    #: embeddings are missing or made by other networks, or are to be refreshed.
    views: NestedKey = keys.NETWORK_PIXELS
    done: NestedKey = keys.DONE  # bool [1], under "next"
    reward: NestedKey = keys.REWARD  # the task's, [1], under "next"; may be missing
    env_id: NestedKey = keys.ENV_ID  # int64 [1], number of the environment
    #: int64 ``[1]``, of the networks that made the embedding; may be missing.
    version: NestedKey = keys.NETWORKS_VERSION
    #: Only read by a map that knows the actions' turns or keeps walks.
    action: NestedKey = keys.ACTION


@dataclass
class Piece:
    """Successive observations of an environment, and their views if known."""

    env: int
    embeddings: Tensor  # [T, D]
    images: Tensor | None
    ends: bool  # the next observation does not follow on the last one
    #: Degrees by which each observation's action turns the agent, ``[T]``, if known.
    turns: Tensor | None = None
    actions: Tensor | None = None  # int64 [T], if they are read


def cut_pieces(
    data: TensorDictBase,
    names: MapKeys,
    embeddings: Tensor,
    goal_reward: float | None,
    *,
    whole: bool,
    turns: Tensor | None = None,
    with_actions: bool = False,
) -> list[Piece]:
    """Cut a batch ``[E, T]`` where episodes end or agents are put elsewhere.

    Rows that are ``whole`` episodes need no done flag and no number of an environment;
    they are cut where the number of the trajectory changes, too.
    ``turns`` are degrees to the left, of each action ``[A]``; actions are then read,
    as they are ``with_actions``.
    """
    images, env_id = data.get(names.views, None), data.get(names.env_id, None)
    if env_id is None and not whole:
        raise _missing(data, env_id=names.env_id)
    envs = [0] * len(data) if env_id is None else env_id[:, 0].flatten().tolist()
    ends = _ends(data, names, goal_reward, whole)
    has_actions = with_actions or turns is not None
    actions = _actions(data, names, turns) if has_actions else None
    pieces = []
    for row, env in enumerate(envs):
        cuts = [0, *(ends[row].nonzero().flatten() + 1).tolist(), data.shape[1]]
        for start, stop in pairwise(cuts):
            if start < stop:
                views = None if images is None else images[row, start:stop].cpu()
                is_last = bool(ends[row, stop - 1])
                done = None if actions is None else actions[row, start:stop]
                turn = None if turns is None or done is None else turns[done]
                seen = embeddings[row, start:stop]
                pieces.append(Piece(env, seen, views, is_last, turn, done))
    return pieces


def read_embeddings(
    data: TensorDictBase, names: MapKeys, embed: Embed, network_version: int
) -> Tensor:
    """Those of a batch, float32 ``[E, T, D]``; by other networks, made again."""
    embeddings, version = data.get(names.embedding, None), data.get(names.version, None)
    is_current = version is None or bool((version == network_version).all())
    if embeddings is not None and is_current:
        known: Tensor = embeddings.float().cpu()
        check_finite(known)
        return known
    images = data.get(names.views, None)
    if images is not None:
        made: Tensor = embed(images.flatten(0, 1).cpu()).unflatten(0, data.shape)
        return made
    if embeddings is None:
        raise _missing(data, embedding=names.embedding, views=names.views)
    raise ValueError(
        f"batches of other networks must have {names.views!r} to embed again, got "
        f"version {int(version.flatten()[0])} and not {network_version}"
    )


def _ends(
    data: TensorDictBase, names: MapKeys, goal_reward: float | None, whole: bool
) -> Tensor:
    ends = torch.zeros(data.shape, dtype=torch.bool)
    done = data.get(unravel_key(("next", names.done)), None)
    reward = data.get(unravel_key(("next", names.reward)), None)
    if done is not None:
        ends |= done.reshape(*data.shape, -1).any(-1).cpu()
    elif not whole:
        raise _missing(data, done=unravel_key(("next", names.done)))
    if reward is not None and goal_reward is not None:
        ends |= (reward >= goal_reward).reshape(*data.shape, -1).any(-1).cpu()
    if whole:
        ends[:, -1] = True
        trajectory = data.get(keys.TRAJECTORY, None)
        if trajectory is not None:
            number = trajectory.reshape(data.shape).cpu()
            ends[:, :-1] |= number[:, 1:] != number[:, :-1]
    return ends


def _actions(data: TensorDictBase, names: MapKeys, turns: Tensor | None) -> Tensor:
    """Numbers of the actions, int64 ``[E, T]``."""
    action = data.get(names.action, None)
    if action is None:
        raise _missing(data, action=names.action)
    number = None if turns is None else len(turns)
    return as_numbers(action, data.shape, number).cpu()


def _missing(data: TensorDictBase, **wanted: NestedKey) -> ValueError:
    """The sentence for a batch that has none of these entries."""
    rule = " or ".join(repr(key) for key in wanted.values())
    writers = [keys.WRITERS[key] for key in wanted.values() if key in keys.WRITERS]
    hints = [f"add {writer}" for writer in writers]
    names = ", ".join(f"{name}=..." for name in wanted)
    hints.append(f"another key is named by set_keys({names})")
    found = [str(name) for name in data.keys(True, True)]
    return ValueError(f"batches must have {rule} ({'; '.join(hints)}), got {found}")
