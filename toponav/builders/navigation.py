"""From an exploration's run folder to an agent that walks to goals."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from torch import Tensor

from toponav.builders.mazes import make_layout
from toponav.builders.networks import Networks, load_networks
from toponav.builders.run_map import MAP_FILE, load_run_map
from toponav.config import MazeConfig, NavigateConfig, NavigatorConfig, SettingsError
from toponav.envs import Layout
from toponav.evaluation import TrueWays
from toponav.graph import (
    Compare,
    Embed,
    Locomotion,
    Map,
    Navigator,
    TopologicalMap,
)

#: What must be as it was while exploring, beside the layout.
_SAME = ("texture_seed", "paintings", "marks")
_VIEWS_AT_ONCE = 64

#: What a navigator sees with: the map, and `embed`, `compare` and `locomotion`.
Eyes = tuple[Map, Embed, Compare, Locomotion]


@dataclass
class Explored:
    """What an exploration left: networks, a map, and the truth about the map.

    Args:
        networks: in ``eval()`` mode.
        map: grown while exploring.
        poses: float ``[W, 3]``, where the map's waypoints truly are, x and y in map
            units and heading in degrees: for those who pose the task and judge the
            agent, never for the agent.
        layout: of the maze.
        ways: true distances in it.
    """

    networks: Networks
    map: TopologicalMap
    poses: Tensor
    layout: Layout
    ways: TrueWays


def load_explored(config: NavigateConfig) -> Explored:
    """Read the run folder that ``run`` names.

    Raises:
        SettingsError: if it names no exploration, one without networks or map, or one
            of another maze than ``maze``.
    """
    if config.run is None:
        raise SettingsError("run must name the folder of an exploration, got none")
    folder = Path(config.run)
    layout = make_layout(config.maze)
    require_same_maze(folder, config.maze, layout)
    networks = load_networks(folder, setting="run")
    cost = config.navigator.unwalked_cost
    grown, poses = load_run_map(folder, networks, unwalked_cost=cost)
    if not grown.num_waypoints:
        raise SettingsError(
            "run must name an exploration whose map has waypoints, got an empty "
            f"{MAP_FILE} in '{folder}'"
        )
    ways = TrueWays(
        torch.as_tensor(layout.open_mask), slot_cells=list(layout.slots.values())
    )
    return Explored(networks, grown, poses, layout, ways)


def require_same_maze(folder: Path, maze: MazeConfig, layout: Layout) -> None:
    """Refuse the run of another maze.

    Args:
        folder: of the run.
        maze: where the agent is to walk.
        layout: of that maze.

    Raises:
        SettingsError: if the folder holds no run, or one whose layout or pictures
            differ.
    """
    file = folder / "config" / "config.yaml"
    if not file.is_file():
        raise SettingsError(
            f"run must name the folder of an exploration, got '{folder}'"
        )
    found: Any = OmegaConf.to_object(OmegaConf.load(file))
    if not isinstance(found, dict) or "maze" not in found or "reward" not in found:
        raise SettingsError(
            "run must name the folder of an exploration, got that of another recipe, "
            f"'{folder}'"
        )
    explored = MazeConfig(**found["maze"])
    if make_layout(explored).text != layout.text:
        raise SettingsError(
            f"maze must be the one that the run explored, got {maze.name} (did you "
            f"mean maze={explored.name}?)"
        )
    for name in _SAME:
        given, wanted = getattr(maze, name), getattr(explored, name)
        if given != wanted:
            raise SettingsError(
                f"maze.{name} must be {wanted}, as in the run, got {given}"
            )


class WideMap:
    """A map whose embeddings are those of both networks, side by side.

    The map itself has those of the TC-network alone, by which it grew. If the L-network
    has an encoder of its own, its embeddings are made here from the map's views.

    Args:
        grown: the map, which must not change any more.
        embeddings: float32 ``[W, 2 D]``.
    """

    def __init__(self, grown: TopologicalMap, embeddings: Tensor) -> None:
        self.num_waypoints = grown.num_waypoints
        self.embeddings = embeddings
        self.prepared = grown.prepared
        self.edges = grown.edges
        self.edge_cost = grown.edge_cost
        self.version = grown.version
        self.neighbourhood = grown.neighbourhood


@torch.no_grad()
def _with_both_embeddings(explored: Explored) -> Eyes:
    tc, locomotion = explored.networks.tc, explored.networks.locomotion
    grown, length = explored.map, explored.map.embeddings.shape[1]

    def embed(views: Tensor) -> Tensor:
        return torch.cat([tc.embed(views), locomotion.encoder(views)], -1)

    def compare(embedding: Tensor, prepared: Tensor) -> Tensor:
        return tc.compare_prepared(embedding[:, :length], prepared)

    def act(here: Tensor, there: Tensor) -> Tensor:
        logits: Tensor = locomotion.head(here[:, length:], there[:, length:])
        return logits

    views = grown.images.split(_VIEWS_AT_ONCE)
    second = torch.cat([locomotion.encoder(some).float() for some in views])
    wide = WideMap(grown, torch.cat([grown.embeddings, second], 1))
    return wide, embed, compare, act


def make_navigator(
    config: NavigatorConfig, explored: Explored, *, seed: int = 0
) -> Navigator:
    """The agent: networks and map of an exploration, and the settings of this run.

    Args:
        config: how it walks.
        explored: what it knows.
        seed: of its actions.
    """
    tc, locomotion = explored.networks.tc, explored.networks.locomotion
    grown = explored.map
    eyes: Eyes
    if locomotion.encoder is tc.encoder:
        eyes = (grown, tc.embed, tc.compare_prepared, locomotion.head)
    else:
        eyes = _with_both_embeddings(explored)
    return Navigator(
        *eyes,
        tc_reach=grown.tc_reach if config.tc_reach is None else config.tc_reach,
        hops=config.hops,
        window=config.window,
        shortlist=config.shortlist,
        stay_above=grown.tc_threshold if config.hysteresis else None,
        follow=config.follow,
        lookahead=config.lookahead,
        temperature=config.temperature,
        avoid_futile=config.avoid_futile,
        block_after=config.block_after,
        keep_cuts=config.keep_cuts,
        fade_after=config.fade_after,
        goal_patience=config.goal_patience,
        lost_for=config.lost_for,
        seed=seed,
    )
