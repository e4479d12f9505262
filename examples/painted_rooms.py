"""Four rooms of MiniGrid, painted so that no two places look alike.

For curious_minigrid.py. The walls of each room have a colour of their own, and a third
of all squares a coloured tile: of the 1,040 views there, 1,039 differ.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
from gymnasium.utils import seeding
from minigrid.core.actions import Actions
from minigrid.core.constants import COLOR_NAMES
from minigrid.core.world_object import Floor
from minigrid.envs import FourRoomsEnv
from minigrid.wrappers import RGBImgPartialObsWrapper
from tensordict import TensorDictBase
from tensordict.nn import (
    TensorDictModule,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torchrl.envs import (
    Compose,
    InitTracker,
    StepCounter,
    Transform,
    TransformedEnv,
)

from toponav import keys
from toponav.data import DrawnPairs
from toponav.envs import GymChoices, make_pixel_env
from toponav.modules import TCNetwork
from toponav.transforms import PlacesVisited

WALLS, TILES, LAYOUT = ("red", "green", "blue", "yellow"), 0.3, 1


class PaintedRooms(FourRoomsEnv):
    """The same rooms in every episode, without a goal; the start is another one."""

    #: What is seen from each place, by all rooms of a process: it never changes.
    seen: dict[tuple[Any, ...], Any] = {}

    def _gen_grid(self, width: int, height: int) -> None:
        own, self._np_random = self.np_random, seeding.np_random(LAYOUT)[0]
        super()._gen_grid(width, height)
        for place, thing in enumerate(self.grid.grid):
            row, column = divmod(place, width)
            if thing is not None and thing.type == "wall":
                room = 2 * (column > width // 2) + (row > height // 2)
                thing.color = WALLS[room]
            else:
                tile = Floor(self._rand_elem(COLOR_NAMES))
                self.grid.grid[place] = tile if self._rand_float(0, 1) < TILES else None
        self._np_random = own
        self.place_agent()

    def gen_obs(self) -> dict[str, Any]:
        return self._once("codes", super().gen_obs)

    def get_frame(self, *look: Any, **names: Any) -> Any:
        make = super().get_frame
        return self._once((look, *names.items()), lambda: make(*look, **names))

    def _once(self, what: Any, make: Callable[[], Any]) -> Any:
        place = (what, *map(int, self.agent_pos), self.agent_dir)
        if place not in self.seen:
            self.seen[place] = make()
        return self.seen[place]


def make_env(*steps: Transform, envs: int, length: int, seed: int) -> TransformedEnv:
    """Rooms side by side, seen as 28 x 28 pixels; the agent turns and walks.

    Where it is, and how many squares an episode has entered, is for reports, under
    privileged keys.
    """
    choices = GymChoices(
        options={"max_steps": length + 1},  # its own end would count as a failure
        wrappers=[partial(RGBImgPartialObsWrapper, tile_size=4)],
        actions=[Actions.left, Actions.right, Actions.forward],
        position=["agent_pos.0", "agent_pos.1"],
    )
    env = make_pixel_env(
        "PaintedRooms-v0",
        batch_size=envs,
        episode_length=length,
        seed=seed,
        choices=choices,
        privileged=True,
    )
    return TransformedEnv(env, Compose(StepCounter(), PlacesVisited(1.0), *steps))


def count_squares(batch: TensorDictBase) -> float:
    """Mean number that an episode of ``[E, T]`` has entered."""
    return batch["next"][keys.PLACES][:, -1].float().mean().item()


def share_right(network: TCNetwork, walks: TensorDictBase) -> float:
    """Share of 4,096 pairs of ``[E, T]``, half of them close, that it tells."""
    pairs, _ = DrawnPairs(walks, 4096, in_key=keys.PIXELS)()
    right = (network(pairs[keys.ANCHOR], pairs[keys.OTHER]) > 0) == pairs[keys.LABEL]
    return right.float().mean().item()


def walk_to(
    goals: TensorDictBase, policy: TensorDictModuleBase, seed: int
) -> TensorDictBase:
    """256 decisions towards the view of each goal ``[N]``, from anywhere."""
    views = goals[keys.PIXELS].unsqueeze(1)
    show = TensorDictModule(lambda: views, [], [keys.GOAL_VIEWS])
    env = make_env(InitTracker(), envs=len(goals), length=256, seed=seed)
    return env.rollout(256, TensorDictSequential(show, policy))


def share_arrived(walks: TensorDictBase, goals: TensorDictBase, by: int) -> float:
    """Share of walks ``[E, T]`` that came to the square of their goal by a decision."""
    here, there = walks["next"][keys.POSITION], goals[keys.POSITION].unsqueeze(1)
    return (here[:, :by] == there).all(-1).any(1).float().mean().item()


gymnasium.register("PaintedRooms-v0", PaintedRooms)
