"""From batches to pieces of episodes: what one environment saw without a break."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from toponav.graph.waypoints import check_finite
from toponav.keys import DONE, EMBEDDING, ENV_ID, NETWORKS_VERSION, PIXELS, REWARD


@dataclass
class Piece:
    """Observations in a row of one environment.

    Args:
        env: number of the environment.
        embeddings: float32 ``[T, D]``.
        images: ``[T, H, W, C]``, if the views are known.
        ends: whether what comes next does not follow on the last observation.
    """

    env: int
    embeddings: Tensor
    images: Tensor | None
    ends: bool


def read_pieces(
    data: TensorDictBase,
    *,
    embed: Callable[[Tensor], Tensor],
    network_version: int = 0,
    respawn_reward: float | None = None,
    whole: bool = False,
) -> list[Piece]:
    """Cut a batch where episodes end or agents are put elsewhere.

    Args:
        data: ``[E, T]`` decisions with `EMBEDDING` or `PIXELS`, and the done flags
            and `ENV_ID` unless ``whole``.
        embed: embeds views, if there are no embeddings or they are of other networks.
        network_version: of the embeddings that are wanted.
        respawn_reward: a task reward from this on means that the agent was put
            elsewhere.
        whole: whether every row is an episode that nothing follows on; it is then
            read as of environment 0 unless `ENV_ID` is there.

    Returns:
        The pieces, environment by environment, in the order of time.

    Raises:
        ValueError: if something is missing or an embedding is not finite.

    Examples:
        >>> from tensordict import TensorDict
        >>> done = torch.tensor([[[False], [True], [False]]])
        >>> data = TensorDict({"embedding": torch.zeros(1, 3, 2)}, [1, 3])
        >>> data["next"], data["env_id"] = {"done": done}, torch.full((1, 3, 1), 7)
        >>> pieces = read_pieces(data, embed=lambda views: views)
        >>> [(piece.env, len(piece.embeddings), piece.ends) for piece in pieces]
        [(7, 2, True), (7, 1, False)]
    """
    images = data.get(PIXELS, None)
    images = None if images is None else images.cpu()
    embeddings = _embeddings(data, images, embed, network_version)
    ends = _ends(data, respawn_reward, whole)
    if ENV_ID in data.keys(True):
        envs = data.get(ENV_ID)[:, 0].flatten().tolist()
    elif whole:
        envs = [0] * len(data)
    else:
        raise ValueError(f"batches must have {ENV_ID!r}, got {_names(data)}")
    pieces = []
    for row, env in enumerate(envs):
        cuts = [0, *(ends[row].nonzero().flatten() + 1).tolist()]
        for start, stop in zip(cuts, [*cuts[1:], data.shape[1]], strict=True):
            if start == stop:
                continue
            pieces.append(
                Piece(
                    env,
                    embeddings[row, start:stop],
                    None if images is None else images[row, start:stop],
                    bool(ends[row, stop - 1]),
                )
            )
    return pieces


def _embeddings(
    data: TensorDictBase,
    images: Tensor | None,
    embed: Callable[[Tensor], Tensor],
    network_version: int,
) -> Tensor:
    """The embeddings ``[E, T, D]`` by the networks of one version."""
    embeddings, version = data.get(EMBEDDING, None), data.get(NETWORKS_VERSION, None)
    if embeddings is not None:
        if version is None or bool((version == network_version).all()):
            known: Tensor = embeddings.float().cpu()
            check_finite(known)
            return known
        if images is None:
            raise ValueError(
                f"batches of other networks must have {PIXELS!r} to embed anew, got "
                f"version {int(version.flatten()[0])} and not {network_version}"
            )
    if images is None:
        raise ValueError(
            f"batches must have {EMBEDDING!r} or {PIXELS!r}, got {_names(data)}"
        )
    made: Tensor = embed(images.flatten(0, 1)).unflatten(0, data.shape)
    return made


def _ends(data: TensorDictBase, respawn_reward: float | None, whole: bool) -> Tensor:
    """After which decisions what follows is not the next observation, ``[E, T]``."""
    ends = torch.zeros(data.shape, dtype=torch.bool)
    done = data.get(_under_next(DONE), None)
    if done is not None:
        ends |= done.reshape(*data.shape, -1).any(-1).cpu()
    elif not whole:
        raise ValueError(f"batches must have {_under_next(DONE)}, got {_names(data)}")
    reward = data.get(_under_next(REWARD), None)
    if reward is not None and respawn_reward is not None:
        ends |= (reward >= respawn_reward).reshape(*data.shape, -1).any(-1).cpu()
    if whole:
        ends[:, -1] = True
    return ends


def _under_next(key: NestedKey) -> NestedKey:
    return ("next", key) if isinstance(key, str) else ("next", *key)


def _names(data: TensorDictBase) -> list[str]:
    return [str(key) for key in data.keys(True)]
