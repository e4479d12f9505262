"""What each rule of a map's growth changes, on the same walks.

    python benchmarks/map_levers.py --networks runs/pretrain/random-... \
        --run runs/explore/random-... --out results/map_levers.csv \
        maze=random maze.rows=5 maze.cols=6 maze.seed=3

An explorer's policy (or, without ``--run``, an expert that is interrupted by sticky
random walks) plays some episodes, whose embeddings are kept in ``--walks``. Maps grow
over them, by the default rules and with each lever and each set of them, and the ground
truth judges them. Times are processor time.
"""

import argparse
import csv
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import Compose, InitTracker, TransformedEnv

from toponav.builders import (
    Networks,
    World,
    action_effects,
    collect_rollout,
    load_networks,
    make_map,
)
from toponav.config import ExploreConfig, MapConfig
from toponav.graph import MoveRules, PoseRules, SupportRules, consolidate
from toponav.ground_truth import GroundTruthDistances, WaypointPoses, require_motion
from toponav.keys import ACTION, EMBEDDING, ENV_ID, HEADING, POSITION
from toponav.methods import LEARNERS, make_reward, make_world
from toponav.metrics import map_quality, waypoint_shares
from toponav.policies import FrontierExpert, StickyPolicy, forward_weights
from toponav.training import Explorer, make_explore_env
from toponav.transforms import AreaDownsample, EmbedViews

sys.path.append(str(Path(__file__).parent))
from reward_guards import make_settings

#: The rules that belong together, and what they are in each row of the table.
TURNS: dict[str, Any] = {"turn_tolerance": 30.0}
SURE: dict[str, Any] = {"edge_threshold": 0.98}
LOWER: dict[str, Any] = {"tc_threshold": "0.87", "surroundings_above": 0.6}
LEVERS: dict[str, dict[str, Any]] = {
    "default": {},
    "turns": TURNS,
    "sure edges": SURE,
    "lower threshold": LOWER,
    "turns, sure edges": TURNS | SURE,
    "turns, lower threshold": TURNS | LOWER,
    "sure edges, lower threshold": SURE | LOWER,
    "all": {**TURNS, **SURE, **LOWER},
    "no surroundings": {"surroundings": 0},
    "surroundings 8": {"surroundings": 8},
    "surroundings above 0.8": {"surroundings_above": 0.8},
    "edges both": {"edges": "both"},
    "untraversed edges cost 1": {"untraversed_edge_cost": 1.0},
    "window 0": {"window": 0},
    "window 3": {"window": 3},
    "search window 1": {"search_window": 1},
    "search window 4": {"search_window": 4},
    "no hysteresis": {"hysteresis": False},
    "poses": {},
}
LEVERS |= {
    f"poses, {lever}": LEVERS[lever]
    for lever in list(LEVERS)
    if lever.startswith(("no ", "window", "search window"))
}
#: Which moves become edges of a map by poses: other rows of the table.
MOVES: dict[str, MoveRules] = {
    "poses, all moves": MoveRules(often=1),
    "poses, shorter ways": MoveRules(detour=1.0, beyond=1.0),
    "poses, moves three times": MoveRules(often=3),
    "poses, longer ways": MoveRules(detour=2.5, beyond=6.0),
}
#: Which waypoints such a map takes: as they come, or those with most support first.
SUPPORT: dict[str, SupportRules] = {
    "poses, nobody asked": SupportRules(most=0, least=0.0),
    "poses, none doubted": SupportRules(least=0.0),
    "poses, below 0.2 doubted": SupportRules(least=0.2),
    "poses, below 0.6 doubted": SupportRules(least=0.6),
}
LEVERS |= dict.fromkeys([*MOVES, *SUPPORT], LEVERS["poses"])
ENVS, ROLLOUT = 8, 120
MEASURED: tuple[str, ...] = (
    *("waypoints", "edges", "coverage", "false_edges", "missing_edges", "false_paths"),
    *("components", "true_components", "stretch"),
)
COLUMNS: tuple[str, ...] = (
    "lever",
    "views",
    "waypoints_per_cell",
    "last_waypoint_share",
    *MEASURED,
)
COLUMNS += ("ms_per_view",)


class Interrupted(TensorDictModuleBase):
    """An expert that visits every cell, with spells of a sticky random walk."""

    out_keys = [ACTION]

    def __init__(self, world: World, seed: int) -> None:
        super().__init__()
        assert world.layout is not None
        mask, spec = torch.as_tensor(world.layout.open_mask), world.spec
        self.expert = FrontierExpert(mask, world=spec, seed=seed)
        weights = forward_weights(spec)
        self.walk = StickyPolicy(spec.num_actions, weights=weights, seed=seed)
        self.in_keys = self.expert.in_keys
        self.generator = torch.Generator().manual_seed(seed)
        self.strays = torch.empty(0, dtype=torch.bool)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.strays.shape != tensordict.batch_size:
            self.strays = torch.zeros(tensordict.batch_size, dtype=torch.bool)
        chance = torch.rand(tensordict.batch_size, generator=self.generator)
        self.strays = torch.where(self.strays, chance > 0.08, chance < 0.02)
        expert = self.expert(tensordict.clone(False))[ACTION]
        walk = self.walk(tensordict.clone(False))[ACTION]
        return tensordict.set(ACTION, torch.where(self.strays, walk, expert))


@torch.no_grad()
def record(
    settings: ExploreConfig,
    world: World,
    networks: Networks,
    run: Path | None,
    episodes: int,
) -> TensorDictBase:
    """Embeddings, actions and poses of whole episodes, ``[N, T]``."""
    envs, seed = min(episodes, 2 * ENVS), settings.seed
    policy: TensorDictModuleBase = Interrupted(world, seed)
    if run is None:
        base = world.make_env(batch_size=envs, seed=seed, privileged=True)
        small = AreaDownsample(factor=2 if settings.model.halve else 1)
        chain = Compose(small, EmbedViews(networks.tc.embed), InitTracker())
        env = TransformedEnv(base, chain)
    else:
        policy = LEARNERS[settings.loss.name].make_policy(settings, world)
        saved = torch.load(run / "policy.pt", weights_only=True)
        policy.load_state_dict(saved["weights"])
        explorer = Explorer(policy, make_reward(settings, world, networks), networks)
        env = make_explore_env(settings, world, explorer, envs=envs, seed=seed)
    keys, length = [EMBEDDING, ACTION, POSITION, HEADING], world.episode_length
    try:
        parts = [
            collect_rollout(env, policy, length, keep=keys).frames
            for _ in range(-(-episodes // envs))
        ]
    finally:
        env.close()
    return torch.cat(parts)[:episodes]


def batches(walks: TensorDictBase) -> list[TensorDictBase]:
    """Episodes as a collector's batches ``[E, T]``, E episodes side by side."""
    found = []
    for start in range(0, len(walks), ENVS):
        some = walks[start : start + ENVS]
        number = torch.arange(len(some)).reshape(-1, 1, 1)
        done = torch.zeros(*some.shape, 1, dtype=torch.bool)
        done[:, -1] = True
        some = some.clone(False).set(ENV_ID, number.expand(*some.shape, 1))
        some["next"] = TensorDict({"done": done}, some.shape)
        found += [piece.contiguous() for piece in some.split(ROLLOUT, 1)]
    return found


def grow(
    config: MapConfig,
    walks: TensorDictBase,
    world: World,
    networks: Networks,
    move_rules: MoveRules | None = None,
    support_rules: SupportRules | None = None,
) -> list[float]:
    """The numbers of one row, from ``views`` on."""
    effects = action_effects(world.spec) if config.poses else None
    topological_map = make_map(
        config,
        networks.tc,
        networks.thresholds,
        world=world.spec,
        keep_walks=effects is not None,
    )
    poses, growth, spent = WaypointPoses(), [(0, 0)], 0.0
    for batch in batches(walks):
        poses.remember(batch)
        start = time.process_time()
        new = topological_map.extend(batch)
        spent += time.process_time() - start
        growth.append((growth[-1][0] + batch.numel(), topological_map.num_waypoints))
        if new:
            poses.extend(topological_map.waypoints.origins)
    if effects is not None:
        start = time.process_time()
        kept = consolidate(
            topological_map,
            effects,
            PoseRules(above=topological_map.rules.tc_threshold),
            within=config.poses_within,
            above=config.poses_above,
            move_rules=move_rules,
            support_rules=support_rules,
        ).kept
        spent += time.process_time() - start
        poses.keep(kept)
        growth = [
            (views, int(torch.searchsorted(kept, number))) for views, number in growth
        ]
    assert world.layout is not None
    mask = torch.as_tensor(world.layout.open_mask)
    distances = GroundTruthDistances(
        mask, cell_size=require_motion(world.spec).cell_size
    )
    cost = topological_map.edge_cost.amin(1)
    quality = vars(map_quality(distances, poses.values, topological_map.edges, cost))
    views, cells = growth[-1][0], int(mask.sum())
    shares = waypoint_shares(growth)["last_waypoint_share"]
    found = [views, topological_map.num_waypoints / cells, shares]
    return [*found, *(quality[name] for name in MEASURED), 1e3 * spent / views]


def main() -> None:
    """Record or read the walks, grow the maps, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maze", nargs="+", help="settings of the maze")
    parser.add_argument("--networks", required=True)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--walks", type=Path)
    parser.add_argument("--levers", nargs="+", default=list(LEVERS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    networks = load_networks(options.networks)
    settings = make_settings(*options.maze, seed=options.seed).resolved(networks.model)
    world = make_world(settings)
    if options.walks and options.walks.exists():
        walks = TensorDict.load_memmap(options.walks).contiguous()
    else:
        walks = record(settings, world, networks, options.run, options.episodes)
        if options.walks:
            walks.memmap(options.walks)
    rows = []
    for lever in options.levers:
        by_poses = lever.startswith("poses")
        config = replace(settings.map, poses=by_poses, **LEVERS[lever])
        played = walks[: options.episodes]
        rules = MOVES.get(lever), SUPPORT.get(lever)
        numbers = grow(config, played, world, networks, *rules)
        rows.append([lever, *(round(float(value), 4) for value in numbers)])
        print(dict(zip(COLUMNS, rows[-1], strict=True)), flush=True)
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
