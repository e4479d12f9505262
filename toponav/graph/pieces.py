"""From batches to pieces of episodes: what one environment saw without a break."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor

from toponav.graph.waypoints import Embed, check_finite
from toponav.keys import (
    DONE,
    EMBEDDING,
    ENV_ID,
    NETWORK_PIXELS,
    NETWORKS_VERSION,
    REWARD,
)


@dataclass(frozen=True)
class MapKeys:
    """The keys that `TopologicalMap` reads of a batch; see its ``set_keys``."""

    embedding: NestedKey = EMBEDDING  # float [D]
    #: uint8 ``[H, W, C]``; only needed where embeddings are missing or made by other
    #: networks, or where the map's embeddings are to be refreshed.
    views: NestedKey = NETWORK_PIXELS
    done: NestedKey = DONE  # bool [1], under "next"
    reward: NestedKey = REWARD  # the task's, [1], under "next"; may be missing
    env_id: NestedKey = ENV_ID  # int64 [1], number of the environment
    #: int64 ``[1]``, of the networks that made the embedding; may be missing.
    version: NestedKey = NETWORKS_VERSION


@dataclass
class Piece:
    """Successive observations ``[T, D]`` of an environment, and their views if known.

    ``ends`` says whether the next observation does not follow on the last one.
    """

    env: int
    embeddings: Tensor
    images: Tensor | None
    ends: bool


def cut_pieces(
    data: TensorDictBase,
    keys: MapKeys,
    embeddings: Tensor,
    goal_reward: float | None,
    *,
    whole: bool,
) -> list[Piece]:
    """Cut a batch ``[E, T]`` where episodes end or agents are put elsewhere.

    The pieces are in the order of environments, then of time. If the rows are ``whole``
    episodes, they need no done flag, and are of environment 0 without its number.
    """
    images, env_id = data.get(keys.views, None), data.get(keys.env_id, None)
    if env_id is None and not whole:
        raise _missing(f"{keys.env_id!r}", data)
    envs = [0] * len(data) if env_id is None else env_id[:, 0].flatten().tolist()
    ends = _ends(data, keys, goal_reward, whole)
    pieces = []
    for row, env in enumerate(envs):
        cuts = [0, *(ends[row].nonzero().flatten() + 1).tolist(), data.shape[1]]
        for start, stop in pairwise(cuts):
            if start < stop:
                views = None if images is None else images[row, start:stop].cpu()
                is_last = bool(ends[row, stop - 1])
                pieces.append(Piece(env, embeddings[row, start:stop], views, is_last))
    return pieces


def read_embeddings(
    data: TensorDictBase, keys: MapKeys, embed: Embed, network_version: int
) -> Tensor:
    """Those of a batch, float32 ``[E, T, D]``; by other networks, made again."""
    embeddings, version = data.get(keys.embedding, None), data.get(keys.version, None)
    is_current = version is None or bool((version == network_version).all())
    if embeddings is not None and is_current:
        known: Tensor = embeddings.float().cpu()
        check_finite(known)
        return known
    images = data.get(keys.views, None)
    if images is not None:
        made: Tensor = embed(images.flatten(0, 1).cpu()).unflatten(0, data.shape)
        return made
    if embeddings is None:
        raise _missing(f"{keys.embedding!r} or {keys.views!r}", data)
    raise ValueError(
        f"batches of other networks must have {keys.views!r} to embed again, got "
        f"version {int(version.flatten()[0])} and not {network_version}"
    )


def _ends(
    data: TensorDictBase, keys: MapKeys, goal_reward: float | None, whole: bool
) -> Tensor:
    ends = torch.zeros(data.shape, dtype=torch.bool)
    done = data.get(unravel_key(("next", keys.done)), None)
    reward = data.get(unravel_key(("next", keys.reward)), None)
    if done is not None:
        ends |= done.reshape(*data.shape, -1).any(-1).cpu()
    elif not whole:
        raise _missing(f"{('next', keys.done)}", data)
    if reward is not None and goal_reward is not None:
        ends |= (reward >= goal_reward).reshape(*data.shape, -1).any(-1).cpu()
    if whole:
        ends[:, -1] = True
    return ends


def _missing(wanted: str, data: TensorDictBase) -> ValueError:
    found = [str(name) for name in data.keys(True)]
    return ValueError(f"batches must have {wanted}, got {found}")
