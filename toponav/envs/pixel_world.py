"""`make_pixel_env`: any Gymnasium environment with pictures as a batched world."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from toponav.envs.gym_pictures import (
    GymChoices,
    GymEnv,
    make_gym_env,
    read_position,
)
from toponav.envs.specs import episode_streams, masked_rows, read_actions, set_world
from toponav.keys import POSITION, PRIVILEGED
from toponav.worlds import WorldSpec


def make_pixel_env(
    id: str,
    *,
    batch_size: int,
    episode_length: int,
    seed: int,
    render: bool = False,
    choices: GymChoices | None = None,
    privileged: bool = False,
    device: torch.device | str = "cpu",
) -> EnvBase:
    """A batch of any Gymnasium environment that shows pictures and takes numbers.

    Its keys are those of ``MazeEnv``, without the ground truth but for a position, if
    ``choices`` say where to find one. Each episode is a function of seed, row and the
    number of episodes that the row has begun.

    Args:
        id: what ``gymnasium.make`` takes. Observations must be a uint8 ``[H, W, 3]``
            box, or a dictionary with one such entry, after the wrappers of ``choices``.
        batch_size: number of environments E; they step one after the other.
        episode_length: decisions after which an episode is truncated at the latest.
        seed: seed of the episodes.
        render: whether ``pixels`` is what the environment renders.
        choices: wrappers, the actions to use, and more; `GymChoices`.
        privileged: whether the position is written; no agent may read it.
        device: where the tensors go.

    Raises:
        ValueError: if it is unknown, has no pixels or no discrete actions, or if the
            choices do not fit it.

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
    choices = choices or GymChoices()
    choices = replace(choices, render=render or choices.render)
    envs, actions = list[GymEnv](), tuple[str, ...]()
    try:
        for _ in range(batch_size):
            env, actions = make_gym_env(id, choices)
            envs.append(TimeLimit(env, episode_length))
        height, width, _ = envs[0].observation_space.shape or ()
        place_size = choices.square if choices.position else None
        world = WorldSpec(
            view_size=(height, width), actions=actions, place_size=place_size
        )
        position = choices.position if privileged else ()
        return _PixelEnv(
            envs,
            world,
            position,
            seed=seed,
            reset_seed=choices.reset_seed,
            device=device,
        )
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
        position: Sequence[str],
        *,
        seed: int,
        reset_seed: int | None,
        device: torch.device | str,
    ) -> None:
        super().__init__(device=device, batch_size=torch.Size([len(envs)]))
        self._envs = envs
        self._position = position
        self._reset_seed = reset_seed
        self._pixels = np.zeros((len(envs), *world.view_size, 3), dtype=np.uint8)
        self._places = np.zeros((len(envs), 2), dtype=np.float32)
        if position:
            known = Unbounded((len(envs), 2), device=device, dtype=torch.float32)
            truth = Composite(position=known, shape=self.batch_size, device=device)
            set_world(self, world, {PRIVILEGED: truth})
        else:
            set_world(self, world)
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self._streams = episode_streams(seed, len(self._envs))

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        self._pixels = self._pixels.copy()
        for row in masked_rows(tensordict, "_reset", len(self._envs)):
            seed = self._reset_seed
            if seed is None:
                seed = int(self._streams[row].integers(2**31))
            self._pixels[row], info = self._envs[row].reset(seed=seed)
            self._see_position(row, info)
        outcomes = np.zeros((3, len(self._envs), 1), dtype=np.float32)
        return self._tensordict(outcomes).exclude("reward")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        rows = masked_rows(tensordict, "_step", len(self._envs))
        actions = read_actions(tensordict, rows, self)
        self._pixels = self._pixels.copy()
        outcomes = np.zeros((3, len(self._envs), 1), dtype=np.float32)
        for row in rows:
            self._pixels[row], *outcome, info = self._envs[row].step(actions[row])
            outcomes[:, row, 0] = outcome
            self._see_position(row, info)
        return self._tensordict(outcomes)

    def _see_position(self, row: int, info: Mapping[str, Any]) -> None:
        if self._position:
            self._places = self._places.copy()
            found = read_position(self._envs[row], info, self._position)
            self._places[row] = found

    def _tensordict(self, outcomes: NDArray[np.float32]) -> TensorDict:
        """The pixels with rewards and whether episodes terminate and truncate."""
        reward, terminated, truncated = torch.from_numpy(outcomes)
        data = TensorDict(
            pixels=torch.from_numpy(self._pixels),
            reward=reward,
            terminated=terminated.bool(),
            truncated=truncated.bool(),
            done=(terminated + truncated).bool(),
            batch_size=self.batch_size,
        )
        if self._position:
            data[POSITION] = torch.from_numpy(self._places)
        # Nobody writes to these arrays again, so that a copy to a GPU may be under way.
        return data.to(self.device, non_blocking=True)

    def close(self, *, raise_if_closed: bool = True) -> None:
        for env in self._envs:
            env.close()
        super().close(raise_if_closed=raise_if_closed)
