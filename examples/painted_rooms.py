"""Four rooms of MiniGrid, each painted its own colour, for curious_minigrid.py."""

import gymnasium
from gymnasium.utils import seeding
from minigrid.core.actions import Actions
from minigrid.envs import FourRoomsEnv
from torchrl.envs import Compose, StepCounter, Transform, TransformedEnv

from toponav.envs import GymChoices, make_pixel_env
from toponav.transforms import PlacesVisited

COLORS = ("red", "green", "blue", "yellow")


class PaintedRooms(FourRoomsEnv):
    """The same rooms in every episode, without a goal; the start is another one."""

    def _gen_grid(self, width: int, height: int) -> None:
        own, self._np_random = self.np_random, seeding.np_random(1)[0]
        super()._gen_grid(width, height)
        self._np_random = own
        for place, thing in enumerate(self.grid.grid):
            row, column = divmod(place, width)
            if thing is not None and thing.type == "wall":
                room = 2 * (column > width // 2) + (row > height // 2)
                thing.color = COLORS[room]
            else:
                self.grid.grid[place] = None
        self.place_agent()


def make_env(*steps: Transform, envs: int, length: int, seed: int) -> TransformedEnv:
    """Rooms side by side, seen as 56 x 56 pixels; the agent turns and walks.

    How many squares an episode has entered is for reports, under a privileged key.
    """
    choices = GymChoices(
        options={"max_steps": length + 1},  # its own end would count as a failure
        wrappers=["minigrid.wrappers.RGBImgPartialObsWrapper"],
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


gymnasium.register("PaintedRooms-v0", PaintedRooms)
