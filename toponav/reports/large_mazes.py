"""`large_maze_hints`: what a maze asks for that is larger than the defaults are for."""

import math

from toponav.builders import World
from toponav.config import ExploreConfig

# Smaller mazes than this are those that the defaults were chosen in.
_LARGE = 100  # open cells
# An explorer that covers a maze has a waypoint for every second cell or so.
_CELLS_PER_WAYPOINT = 2
# Decisions for each open cell that episodes of 1,800 give in a maze of 63.
_PER_CELL = 1_800 / 63


def large_maze_hints(settings: ExploreConfig, world: World) -> list[str]:
    """A sentence for each setting that is too small for a maze of more than 100 cells.

    They are of the length of episodes and of the waypoints that one remembers. Nothing
    is refused: a part of a maze may be what is wanted.
    """
    layout, motion = world.layout, world.spec.motion
    if layout is None or motion is None or layout.num_cells <= _LARGE:
        return []
    cells, length, found = layout.num_cells, world.episode_length, []
    crossed = math.floor(length / motion.decisions_per_cell)
    if crossed < cells:
        found.append(
            f"An episode of {length:,} decisions crosses at most {crossed} of the "
            f"{cells} open cells: maze.episode_length={round(_PER_CELL * cells)} has "
            "as many for each as the mazes that come with the package."
        )
    # The memory of other methods is no list of waypoints.
    novelty = settings.reward.name == "novelty"
    room: int | None = getattr(settings.reward, "capacity", None) if novelty else None
    if room is not None and room * _CELLS_PER_WAYPOINT < cells:
        found.append(
            f"An episode remembers {room} waypoints, fewer than every second of the "
            f"{cells} open cells needs: reward.capacity=null remembers all."
        )
    return found
