"""`large_maze_hints`: what a maze asks for that is larger than the defaults are for."""

import math

from toponav.builders import World
from toponav.config import ExploreConfig

# Smaller mazes than this are those that the defaults were chosen in.
_LARGE = 100  # open cells
# An explorer that covers a maze has a waypoint for every second cell or so.
_CELLS_PER_WAYPOINT = 2
# Open cells of select, where settings are chosen, in episodes of so many decisions.
_SELECT, _DECISIONS = 49, 1_800
# Views of each open cell that a map by poses is fed. In two layouts of our own 373 and
# 502 were enough, and with 167 a part of a maze lay two cells off
# (results/navigation.md).
_FEW_VIEWS, _ENOUGH_VIEWS = 250, 500


def large_maze_hints(settings: ExploreConfig, world: World) -> list[str]:
    """A sentence for each setting that is too small for a maze of more than 100 cells.

    They are of the length of episodes, of the waypoints that one remembers and of the
    views that the map is fed. Nothing is refused: a part of a maze may be what is
    wanted.
    """
    layout, motion = world.layout, world.spec.motion
    if layout is None or motion is None or layout.num_cells <= _LARGE:
        return []
    cells, length, found = layout.num_cells, world.episode_length, []
    crossed = math.floor(length / motion.decisions_per_cell)
    if crossed < cells:
        found.append(
            f"An episode of {length:,} decisions crosses at most {crossed} of the "
            f"{cells} open cells: maze.episode_length="
            f"{round(_DECISIONS * cells / _SELECT)} has "
            "as many for each as in the maze select."
        )
    # The memory of other methods is no list of waypoints.
    novelty = settings.reward.name == "novelty"
    room: int | None = getattr(settings.reward, "capacity", None) if novelty else None
    if room is not None and room * _CELLS_PER_WAYPOINT < cells:
        found.append(
            f"An episode remembers {room} waypoints, fewer than every second of the "
            f"{cells} open cells needs: reward.capacity=null remembers all."
        )
    return found + _views_hint(settings, cells)


def _views_hint(settings: ExploreConfig, cells: int) -> list[str]:
    """That the map is fed few views of each open cell."""
    envs, fed = settings.collect.envs, settings.map.envs
    by_one = settings.collect.decisions / envs
    # Where it is not made again by poses, a lack of views is not known to matter.
    if not settings.maps_by_poses(effects_known=True) or fed is None or fed == envs:
        return []
    if fed * by_one >= _FEW_VIEWS * cells:
        return []
    enough = min(math.ceil(_ENOUGH_VIEWS * cells / by_one), envs)
    return [
        f"The map is fed {round(fed * by_one / cells)} views for each of the {cells} "
        f"open cells, which may be too few to find where they were taken: "
        f"map.envs={enough} feeds it those of {enough} of the {envs} mazes."
    ]
