"""A run folder of an exploration, made without one: a map of all cells of a ring."""

from pathlib import Path

import numpy as np
import torch
from omegaconf import OmegaConf

from tests.composed import settings
from tests.exploring import explore_settings, world_of
from toponav.builders import (
    MAP_FILE,
    PLACES_FILE,
    POSES_FILE,
    AgentKnowledge,
    GroundTruth,
    MapNetworks,
    load_networks,
    make_layout,
    make_networks,
    save_networks,
    save_places,
)
from toponav.config import ExploreConfig, NavigateConfig
from toponav.graph import save_map
from toponav.training.ground_training import GroundRules, train_ground
from toponav.training.place_training import (
    OffsetRules,
    PlaceRules,
    train_offsets,
    train_places,
)

RING = "*****\n*   *\n* *a*\n*   *\n*****\n"
#: Views of a cell, one in each direction.
DIRECTIONS = (0.0, 90.0, 180.0, 270.0)


#: What a navigation starts from.
Explored = tuple[AgentKnowledge, GroundTruth]


def navigate_settings(folder: Path | None, *overrides: str) -> NavigateConfig:
    run = ["maze=maze1"] if folder is None else [f"run={folder}"]
    found = settings("navigate", "navigate=smoke", *run, *overrides)
    assert isinstance(found, NavigateConfig)
    return found


def make_run(folder: Path, *overrides: str, poses: bool = False) -> ExploreConfig:
    """Write networks that were never trained, and a map that fits the maze.

    Args:
        folder: gets ``config``, ``networks.pt``, the map and its truth; its layout file
            is ``ring.txt``.
        overrides: settings of the exploration.
        poses: whether the map has poses, and a network that knows its places.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "ring.txt").write_text(RING)
    path = f"maze.path={folder / 'ring.txt'}"
    config = explore_settings("maze=file", path, *overrides)
    (folder / "config").mkdir(exist_ok=True)
    OmegaConf.save(OmegaConf.structured(config), folder / "config" / "config.yaml")
    torch.manual_seed(0)
    networks = make_networks(config.model, world_of(config).spec)
    networks.modules.eval()
    networks.thresholds = {"tc_threshold": 0.9, "tc_reach": 0.3}
    save_networks(networks, folder / "networks.pt")
    write_map(folder, config, poses=poses)
    return config


@torch.no_grad()
def write_map(
    folder: Path,
    config: ExploreConfig,
    *,
    cells: int | None = None,
    poses: bool = False,
) -> None:
    """Write the map and its truth.

    Args:
        folder: with networks.
        config: of the run.
        cells: how many of the maze's cells are on the map, all by default.
        poses: as `make_run`; they are the true ones, in a frame of their own.
    """
    world, networks = world_of(config).spec, load_networks(folder)
    tc, layout = networks.tc, make_layout(config.maze)
    known = list(layout.cells)[:cells]
    places = [(cell, turn) for cell in known for turn in DIRECTIONS]
    generator = torch.Generator().manual_seed(0)
    height, width = world.view_size
    shape = (len(places), height // 2, width // 2, 3)
    images = torch.randint(256, shape, generator=generator, dtype=torch.uint8)
    embeddings = tc.embed(images) if len(images) else torch.empty(0, 8)
    edges = [
        (i, j)
        for i, (one, _) in enumerate(places)
        for j, (other, _) in enumerate(places[:i])
        if abs(one[0] - other[0]) + abs(one[1] - other[1]) <= 1
    ]
    pairs = torch.tensor(edges).reshape(-1, 2).long().flip(1)
    state = {
        "embeddings": embeddings,
        "prepared": tc.prepare_memory(embeddings.unsqueeze(1)).squeeze(1),
        "images": images,
        "origins": torch.zeros(len(places), 2, dtype=torch.int64),
        "edges": pairs,
        "traversals": torch.ones(len(pairs), 2, dtype=torch.int64),
        "edge_similarity": torch.full((len(pairs),), 0.9),
        "version": 1,
        "network_version": 0,
        "tc_threshold": 0.9,
        "tc_reach": 0.3,
    }
    motion = world.motion
    truth = [(*layout.centre(cell, motion.cell_size), turn) for cell, turn in places]
    true = torch.tensor(truth, dtype=torch.float32).reshape(-1, 3)
    if poses:
        # From elsewhere, and turned by a quarter.
        x, y, heading = (true / torch.tensor([motion.step, motion.step, 1.0])).unbind(1)
        state["positions"] = torch.stack([5 - y, x - 7], 1)
        state["headings"] = heading + 90
        own = torch.cat([state["positions"], state["headings"].unsqueeze(1)], 1)
        known = embeddings, own, own, motion.turn
        map_networks = MapNetworks(
            train_places(*known, PlaceRules(updates=60, views=32)),
            train_offsets(*known, OffsetRules(updates=60, views=32)),
            train_ground(embeddings, own, GroundRules(updates=20, views=32)),
        )
        save_places(map_networks, folder / PLACES_FILE)
    save_map(state, folder / MAP_FILE)
    np.save(folder / POSES_FILE, np.asarray(true))
