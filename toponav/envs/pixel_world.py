"""`make_pixel_env`: any Gymnasium environment with pictures as a batched world."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.wrappers import AddRenderObservation, TimeLimit, TransformObservation
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from toponav.envs.specs import episode_streams, masked_rows, set_world
from toponav.worlds import WorldSpec

GymEnv = gymnasium.Env[Any, Any]


def make_pixel_env(
    id: str,
    *,
    batch_size: int,
    episode_length: int,
    seed: int,
    render: bool = False,
    device: torch.device | str = "cpu",
) -> EnvBase:
    """A batch of any Gymnasium environment that shows pictures and takes numbers.

    Its keys are those of ``MazeEnv`` without the ground truth. Each episode is a
    function of seed, row and the number of episodes that the row has begun.

    Args:
        id: what ``gymnasium.make`` takes. Observations must be a uint8 ``[H, W, 3]``
            box, or a dictionary with one such entry.
        batch_size: number of environments E; they step one after the other.
        episode_length: decisions after which an episode is truncated at the latest.
        seed: seed of the episodes.
        render: whether ``pixels`` is what the environment renders.
        device: where the tensors go.

    Raises:
        ValueError: if it is unknown, has no pixels or no discrete actions.

    Examples:
        >>> env = make_pixel_env(
        ...     "CartPole-v1", batch_size=2, episode_length=9, seed=0, render=True
        ... )
        >>> env.world.view_size, env.world.actions, env.world.has_truth
        ((400, 600), ('action 0', 'action 1'), False)
        >>> env.close()
    """
    if min(batch_size, episode_length) < 1:
        got = f"{batch_size} and {episode_length}"
        raise ValueError(f"batch_size and episode_length must be at least 1, got {got}")
    envs: list[GymEnv] = []
    try:
        for _ in range(batch_size):
            envs.append(_make_gym_env(id, render))
            pictured = _show_pictures(id, envs[-1], render)
            envs[-1] = TimeLimit(pictured, episode_length)
        height, width, _ = envs[0].observation_space.shape or ()
        actions = _action_names(id, envs[0])
        world = WorldSpec(view_size=(height, width), actions=actions)
        return _PixelEnv(envs, world, seed=seed, device=device)
    except BaseException:
        for env in envs:
            env.close()
        raise


class _PixelEnv(EnvBase):
    world: WorldSpec

    def __init__(
        self,
        envs: Sequence[GymEnv],
        world: WorldSpec,
        *,
        seed: int,
        device: torch.device | str,
    ) -> None:
        super().__init__(device=device, batch_size=torch.Size([len(envs)]))
        self._envs = envs
        self._first_action = int(getattr(envs[0].action_space, "start", 0))
        self._pixels = np.zeros((len(envs), *world.view_size, 3), dtype=np.uint8)
        set_world(self, world)
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self._streams = episode_streams(seed, len(self._envs))

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        self._pixels = self._pixels.copy()
        for row in masked_rows(tensordict, "_reset", len(self._envs)):
            seed = int(self._streams[row].integers(2**31))
            self._pixels[row], _ = self._envs[row].reset(seed=seed)
        outcomes = np.zeros((3, len(self._envs), 1), dtype=np.float32)
        return self._tensordict(outcomes).exclude("reward")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = tensordict.get("action").reshape(-1).tolist()
        self._pixels = self._pixels.copy()
        outcomes = np.zeros((3, len(self._envs), 1), dtype=np.float32)
        for row in masked_rows(tensordict, "_step", len(self._envs)):
            action = self._first_action + actions[row]
            self._pixels[row], *outcome, _ = self._envs[row].step(action)
            outcomes[:, row, 0] = outcome
        return self._tensordict(outcomes)

    def _tensordict(self, outcomes: NDArray[np.float32]) -> TensorDict:
        """The pixels with rewards and whether episodes terminate and truncate."""
        reward, terminated, truncated = torch.from_numpy(outcomes)
        return TensorDict(
            pixels=torch.from_numpy(self._pixels),
            reward=reward,
            terminated=terminated.bool(),
            truncated=truncated.bool(),
            done=(terminated + truncated).bool(),
            batch_size=self.batch_size,
        ).to(self.device)

    def close(self, *, raise_if_closed: bool = True) -> None:
        for env in self._envs:
            env.close()
        super().close(raise_if_closed=raise_if_closed)


def _make_gym_env(id: str, render: bool) -> GymEnv:
    # Some environments take no render_mode.
    options: dict[str, Any] = {"render_mode": "rgb_array"} if render else {}
    try:
        return gymnasium.make(id, **options)
    except (gymnasium.error.Error, ImportError) as error:
        got = f"'{id}': {str(error).strip().splitlines()[0]}"
        raise ValueError(f"id must name a Gymnasium environment, got {got}") from error


def _show_pictures(id: str, env: GymEnv, render: bool) -> GymEnv:
    """An environment whose observations are pictures, uint8 ``[H, W, 3]``."""
    if render:
        try:
            env = AddRenderObservation(env)
        except (TypeError, ValueError) as error:
            message = f"'{id}' must render a picture [H, W, 3], got {error}"
            raise ValueError(message) from error
    space = env.observation_space
    if _is_picture(space):
        return env
    entries = space.spaces if isinstance(space, spaces.Dict) else {}
    keys = [key for key, entry in entries.items() if _is_picture(entry)]
    if len(keys) != 1:
        raise ValueError(
            f"the observation of '{id}' must be or hold one uint8 picture [H, W, 3] "
            f"(render=True takes what it renders), got {space}"
        )
    return TransformObservation(env, itemgetter(keys[0]), entries[keys[0]])


def _is_picture(space: spaces.Space[Any]) -> bool:
    shape = space.shape or ()
    return space.dtype == np.uint8 and len(shape) == 3 and shape[-1] == 3


def _action_names(id: str, env: GymEnv) -> tuple[str, ...]:
    space = env.action_space
    if not isinstance(space, spaces.Discrete):
        raise ValueError(f"the actions of '{id}' must be discrete, got {space}")
    meanings = getattr(env.unwrapped, "get_action_meanings", None)
    if meanings is not None:
        return tuple(meanings())
    return tuple(f"action {number}" for number in range(int(space.n)))
