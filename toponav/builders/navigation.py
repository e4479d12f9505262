"""What an exploration left: to its agent, and to those who judge the agent."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from toponav.builders.maps import empty_map
from toponav.builders.mazes import engine_world, make_layout
from toponav.builders.networks import NETWORKS_FILE, Networks, load_networks
from toponav.config import (
    MazeConfig,
    NavigateConfig,
    refusing,
    require,
    run_setting,
)
from toponav.envs import Layout
from toponav.graph import MapFileError, MapRules, TopologicalMap, load_map
from toponav.ground_truth import GroundTruthDistances, require_motion
from toponav.worlds import WorldSpec

#: The files in a run folder that hold the map, and where its waypoints truly are.
MAP_FILE, POSES_FILE = "map.zip", "map_poses.npy"
#: What must be as it was while exploring, beside the layout.
_APPEARANCE = ("texture_seed", "paintings", "marks")


@dataclass(frozen=True)
class AgentKnowledge:
    """What an agent may know: nothing here holds ground truth.

    Args:
        world: in which it acts.
        networks: in ``eval()`` mode.
        map: built while exploring.
    """

    world: WorldSpec
    networks: Networks
    map: TopologicalMap


@dataclass(frozen=True)
class GroundTruth:
    """For those who pose the task and judge the agent, never for the agent.

    Args:
        poses: float32 ``[W, 3]``, where the map's waypoints truly are, x and y in map
            units and heading in degrees.
        layout: of the maze.
        distances: in it.
    """

    poses: Tensor
    layout: Layout
    distances: GroundTruthDistances


def load_exploration(config: NavigateConfig) -> tuple[AgentKnowledge, GroundTruth]:
    """Read the run folder that ``run`` names.

    Raises:
        SettingsError: if it names no exploration, one without networks or waypoints, or
            one of another maze than ``maze`` or for other views than ``engine`` draws.
    """
    where = run_setting(config.run, "world.name", "maze")
    rule = "run must name the exploration of a maze, which navigation needs"
    require(where == "maze", rule, f"'{config.run}' with world={where}")
    layout = make_layout(config.maze)
    require_same_maze(config.run, config.maze, layout)
    folder, world = Path(str(config.run)), engine_world(config.engine)
    rule = "run must name an exploration with networks and a map"
    rule += ", which reward=novelty leaves, and others that get `pretrained`"
    for name in (NETWORKS_FILE, MAP_FILE, POSES_FILE):
        given = f"'{folder}' without {name}"
        require((folder / name).is_file(), rule, given)
    networks = load_networks(folder, setting="run", world=world)
    topological_map = _load_map(folder, networks)
    poses = _load_poses(folder, topological_map.num_waypoints)
    distances = GroundTruthDistances(
        torch.as_tensor(layout.open_mask),
        cell_size=require_motion(world).cell_size,
        slot_cells=list(layout.slots.values()),
    )
    knowledge = AgentKnowledge(world, networks, topological_map)
    return knowledge, GroundTruth(poses, layout, distances)


def require_same_maze(run: str | None, maze: MazeConfig, layout: Layout) -> None:
    """Refuse the run of a maze with another layout or appearance."""
    names = ("name", "path", "rows", "cols", "seed", "loops", *_APPEARANCE)
    found = {name: run_setting(run, f"maze.{name}") for name in names}
    explored = replace(maze, **found)
    require(
        make_layout(explored).text == layout.text,
        "maze must be the one that the run explored",
        f"{maze.name} (did you mean maze={explored.name}?)",
    )
    for name in _APPEARANCE:
        given, wanted = getattr(maze, name), getattr(explored, name)
        require(given == wanted, f"maze.{name} must be {wanted}, as in the run", given)


def _load_map(folder: Path, networks: Networks) -> TopologicalMap:
    """The map of a run, with networks of the same run."""
    # The thresholds are loaded with the map.
    found = empty_map(networks.tc, MapRules(tc_threshold=0.5, tc_reach=0.5))
    with refusing("run: ", (MapFileError, ValueError)):
        state, _ = load_map(folder / MAP_FILE)
        found.load_state_dict(state)
    rule = "run must name an exploration whose map has waypoints"
    require(found.num_waypoints > 0, rule, f"an empty {MAP_FILE} in '{folder}'")
    return found


def _load_poses(folder: Path, num_waypoints: int) -> Tensor:
    with refusing("run: ", (ValueError, OSError, EOFError)):
        poses = np.load(folder / POSES_FILE, allow_pickle=False)
    rule = f"a row of three for each of {num_waypoints} waypoints"
    rule = f"run must name an exploration whose {POSES_FILE} has {rule}"
    require(poses.shape == (num_waypoints, 3), rule, poses.shape)
    return torch.from_numpy(poses).float()
