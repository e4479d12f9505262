"""Loads an exploration to navigate with: knowledge, ground truth, goals."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import EnvBase, InitTracker, TransformedEnv
from torchrl.envs.transforms import Compose

from toponav.builders.beside_map import MAP_FILE, POSES_FILE, find_beside
from toponav.builders.collection import collect_rollout
from toponav.builders.kept_layout import edited, kept_layout, layout_text
from toponav.builders.map_poses import load_poses
from toponav.builders.maps import empty_map
from toponav.builders.mazes import engine_world, make_env, make_layout
from toponav.builders.networks import NETWORKS_FILE, Networks, load_networks
from toponav.builders.places import PLACES_FILE, MapNetworks, load_places
from toponav.builders.processes import seed_of
from toponav.config import (
    MazeConfig,
    NavigateConfig,
    PractiseConfig,
    SettingsError,
    maze_label,
    refusing,
    require,
    run_setting,
)
from toponav.envs import Layout
from toponav.graph import MapFileError, MapRules, TopologicalMap, load_map
from toponav.ground_truth import GroundTruthDistances, pick_goal_views, require_motion
from toponav.keys import HEADING, PIXELS, POSITION, REWARD
from toponav.policies import FrontierExpert
from toponav.transforms import GoalViews, PreviousReward
from toponav.worlds import WorldSpec

Cell = tuple[int, int]

#: What must be as it was while exploring, beside the layout.
_APPEARANCE = ("texture_seed", "paintings", "marks")
# Apart from the seeds of the episodes.
_WALK, _WALKERS = 55, 4
_PRACTICE = 77
# Decisions of a walk between two choices of pictures; most decisions for each cell.
_CHUNK, _MOST_PER_CELL = 900, 50


@dataclass(frozen=True)
class AgentKnowledge:
    """What an agent may know: nothing here holds ground truth."""

    world: WorldSpec
    networks: Networks  # in eval() mode
    map: TopologicalMap  # built while exploring
    #: Say what a view means on the map, if its waypoints have poses.
    map_networks: MapNetworks | None = None


@dataclass(frozen=True)
class GroundTruth:
    """For those who pose the task and judge the agent, never for the agent."""

    #: float32 ``[W, 3]``; of the map's waypoints, x and y in map units, and degrees.
    poses: Tensor
    layout: Layout
    distances: GroundTruthDistances


def load_exploration(
    config: NavigateConfig | PractiseConfig,
) -> tuple[AgentKnowledge, GroundTruth]:
    """Read the run folder that ``run`` names.

    Raises `SettingsError` if that is no exploration, one without networks or waypoints,
    or one of another maze than ``maze`` or other views than ``engine`` draws.
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
        require((folder / name).is_file(), rule, f"'{folder}' without {name}")
    networks = load_networks(folder, setting="run", world=world)
    topological_map, about = _load_map(folder, networks)
    number = topological_map.num_waypoints
    poses = load_poses(folder, about, num_waypoints=number, setting="run")
    distances = GroundTruthDistances(
        torch.as_tensor(layout.open_mask),
        cell_size=require_motion(world).cell_size,
        slot_cells=list(layout.slots.values()),
    )
    try:
        distances.cell_numbers(poses[:, :2])
    except ValueError as error:
        raise SettingsError(
            "run must name an exploration whose map is one of its maze, got "
            f"'{folder}' with waypoints inside the walls of {layout.name} "
            "(was its layout changed?)"
        ) from error
    truth = GroundTruth(poses, layout, distances)
    map_networks = _load_places(folder, topological_map, about)
    return AgentKnowledge(world, networks, topological_map, map_networks), truth


def load_knowledge(folder: Path, world: WorldSpec) -> AgentKnowledge:
    """What an agent has of an exploration in a world without ground truth.

    Raises `SettingsError` if it has no networks, or no map with waypoints.
    """
    rule = "run must name an exploration with networks and a map"
    for name in (NETWORKS_FILE, MAP_FILE):
        require((folder / name).is_file(), rule, f"'{folder}' without {name}")
    networks = load_networks(folder, setting="run", world=world)
    return AgentKnowledge(world, networks, _load_map(folder, networks)[0])


def require_same_maze(run: str | None, maze: MazeConfig, layout: Layout) -> None:
    """Refuse the run of a maze with another layout or appearance."""
    names = ("name", "path", "rows", "cols", "seed", "loops", *_APPEARANCE)
    found = {name: run_setting(run, f"maze.{name}") for name in names}
    explored, folder = replace(maze, **found), Path(str(run))
    # The file of a run's layout may have been edited since, or be gone.
    kept = kept_layout(folder)
    was = layout_text(make_layout(explored)) if kept is None else kept
    label = f"{maze_label(maze.name, maze.path)} (did you mean maze=run?)"
    require(
        was == layout_text(layout),
        "maze must be the one that the run explored",
        edited(folder, maze) if maze.path and maze.path == explored.path else label,
    )
    for name in _APPEARANCE:
        given, wanted = getattr(maze, name), getattr(explored, name)
        require(given == wanted, f"maze.{name} must be {wanted}, as in the run", given)


def _load_map(
    folder: Path, networks: Networks
) -> tuple[TopologicalMap, dict[str, str]]:
    """The map of a run with networks of the same run, and the words about it."""
    # The thresholds are loaded with the map.
    found = empty_map(networks.tc, MapRules(tc_threshold=0.5, tc_reach=0.5))
    with refusing("run: ", (MapFileError, ValueError)):
        state, about = load_map(folder / MAP_FILE)
        found.load_state_dict(state)
    rule = "run must name an exploration whose map has waypoints"
    require(found.num_waypoints > 0, rule, f"an empty {MAP_FILE} in '{folder}'")
    return found, about


def _load_places(
    folder: Path, known: TopologicalMap, about: Mapping[str, str]
) -> MapNetworks | None:
    if (path := find_beside(folder, PLACES_FILE, about)) is None:
        return None
    number, size = known.embeddings.shape
    return load_places(path, num_places=number, embedding_size=size, setting="run")


@dataclass(frozen=True)
class GoalPlaces:
    """The places where a goal can be: those with pictures."""

    cells: Tensor  # int64 [K, 2], row and column
    views: Tensor  # uint8 [K, V, H, W, 3], V pictures of each
    num_without: int = 0  # how many other places have no picture


def make_goal_places(
    config: NavigateConfig, knowledge: AgentKnowledge, truth: GroundTruth
) -> GoalPlaces:
    """Choose pictures of every cell that is no slot and of which there are some.

    Whoever poses the task knows where each picture was taken; the agent gets the
    pictures alone. Raises `SettingsError` if no cell has one.
    """
    slots = set(truth.layout.slots.values())
    cells = [cell for cell in truth.layout.cells if cell not in slots]
    mapped = np.asarray(truth.poses)
    if config.goals.source == "map":
        views, poses = knowledge.map.waypoints.images, mapped
    else:
        views, poses = _walk_for_views(config, truth, cells)
    chosen = _choose(config, truth, cells, poses)
    found = torch.from_numpy((chosen >= 0).all(1))
    if not found.any():
        # What was not tried; the map may be as empty as the walk.
        other = "goals.source=walk"
        if config.goals.source == "walk":
            good = (_choose(config, truth, cells, mapped) >= 0).all(1).any()
            other = f"{'' if good else 'a longer exploration with '}goals.source=map"
        rule = (
            f"goals.source must have a picture of one of {len(cells)} places at least"
        )
        given = f"none from '{config.goals.source}' (did you mean {other}?)"
        require(False, rule, given)
    pictures = views[torch.from_numpy(chosen)[found]]
    return GoalPlaces(torch.tensor(cells)[found], pictures, int((~found).sum()))


def _choose(
    config: NavigateConfig, truth: GroundTruth, cells: Sequence[Cell], poses: np.ndarray
) -> np.ndarray:
    """Numbers of the pictures of each cell, int ``[K, V]``, -1 without any."""
    places, headings, views = poses[:, :2], poses[:, 2], config.goals.views
    return pick_goal_views(places, headings, cells, truth.distances, num_views=views)


def _walk_for_views(
    config: NavigateConfig, truth: GroundTruth, cells: Sequence[Cell]
) -> tuple[Tensor, np.ndarray]:
    """Views and poses of a scripted walk, of which only those chosen are kept.

    It ends when every walker has visited every cell, or after so many decisions that
    what is missing cannot be reached.
    """
    maze = replace(config.maze, goal=False, blocked=[], apples=0)
    seed, keys = seed_of(config.seed, _WALK), [PIXELS, POSITION, HEADING]
    env = make_env(
        maze, engine=config.engine, batch_size=_WALKERS, seed=seed, privileged=True
    )
    walker = FrontierExpert(
        torch.as_tensor(truth.layout.open_mask),
        world=env.world,
        slot_cells=list(truth.layout.slots.values()),
        init_key=None,
        seed=config.seed,
    )
    views = torch.empty(0, *env.world.view_size, 3, dtype=torch.uint8)
    poses = np.empty((0, 3))
    with closing(env):
        for _ in range(0, _MOST_PER_CELL * len(cells) + _CHUNK, _CHUNK):
            seen = collect_rollout(env, walker, _CHUNK, keep=keys).frames.reshape(-1)
            pose = torch.cat([seen[POSITION], seen[HEADING]], -1)
            views = torch.cat([views, seen[PIXELS]])
            poses = np.concatenate([poses, np.asarray(pose, float)])
            chosen = np.unique(_choose(config, truth, cells, poses))
            kept = chosen[chosen >= 0]
            views, poses = views[kept], poses[kept]
            if walker.visited.all():
                break
    return views, poses


def make_navigation_env(
    config: NavigateConfig,
    places: GoalPlaces,
    *,
    envs: int,
    seed: int,
    velocity: bool = False,
) -> EnvBase:
    """E mazes with a goal, its pictures, and all that a navigator reads.

    The ground truth is there too, for those who judge and for the oracle; the
    ``velocity`` for a trained policy that needs it.
    """
    env = make_env(
        config.maze,
        engine=config.engine,
        batch_size=envs,
        seed=seed,
        privileged=True,
        goal_cells=[(row, column) for row, column in places.cells.tolist()],
        velocity=velocity,
    )
    assert env.world.goal_reward is not None  # mazes have goals
    reward = PreviousReward(env.world.goal_reward, in_keys=[REWARD])
    views = GoalViews(places.cells, places.views)
    return TransformedEnv(env, Compose(views, reward, InitTracker()))


def make_practice_env(config: PractiseConfig) -> EnvBase:
    """Mazes without a goal, and nothing of the ground truth."""
    env = make_env(
        config.maze,
        engine=config.engine,
        batch_size=config.practice.envs,
        seed=seed_of(config.seed, _PRACTICE),
    )
    return TransformedEnv(env, InitTracker())
