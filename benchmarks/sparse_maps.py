"""What merging waypoints costs: a map's size, its quality, and navigation over it.

    python benchmarks/sparse_maps.py --run runs/explore/maze1-... --out sparse.json

The map of a run is made sparser with each tolerance (``map.sparsify``), from the map
as it was left each time. Beside its size and its quality stand the goals that the
topological navigator reaches over it per 1,000 decisions, with 95 % bootstrap
intervals; all meet the same episodes and the same pictures of goals. A tolerance below
0 leaves the map as it is.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from tqdm import trange

from toponav.builders import (
    AgentKnowledge,
    GroundTruth,
    collect_rollout,
    load_exploration,
    make_goal_places,
    make_navigation_env,
)
from toponav.config import NavigateConfig
from toponav.graph import sparsify
from toponav.ground_truth import WaypointPoses
from toponav.keys import REWARD
from toponav.methods import register
from toponav.methods.navigators import CHOSEN, make_policies
from toponav.metrics import bootstrap, map_quality

CONF = Path(__file__).resolve().parent.parent / "conf"


def make_settings(run: str, maze: str, length: int) -> NavigateConfig:
    """Those of the recipe, for episodes of so many decisions."""
    register()
    # The default walks over maps by poses, which have few waypoints without it.
    words = [f"maze={maze}", f"run={run}", "navigator=topological"]
    words.append(f"maze.episode_length={length}")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("navigate", overrides=words))
    assert isinstance(settings, NavigateConfig)
    return settings


def make_sparse(
    knowledge: AgentKnowledge, truth: GroundTruth, tolerance: float
) -> dict[str, Any]:
    """Merge waypoints in place; size and quality of what is left."""
    topological_map, poses = knowledge.map, WaypointPoses(truth.poses)
    if tolerance >= 0:
        poses.merge(sparsify(topological_map, tolerance=tolerance))
    cost = topological_map.edge_cost.amin(1)
    quality = map_quality(truth.distances, poses.values, topological_map.edges, cost)
    return {"tolerance": tolerance, **vars(quality)}


@torch.no_grad()
def play(
    env: EnvBase, policy: TensorDictModuleBase, length: int, *, name: str
) -> torch.Tensor:
    """Goals reached in each episode, ``[E]``."""
    total = env.batch_size[0] * length
    with trange(total, desc=name, unit="decision") as bar:
        played = collect_rollout(
            env, policy, length, keep=(), keep_next=[REWARD], progress=bar.update
        )
    reward = played.frames["next", REWARD].squeeze(-1)
    return (reward >= env.world.goal_reward).float().sum(1)


def main() -> None:
    """Make the map sparser, walk over it, and print what came of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", required=True)
    parser.add_argument("--maze", default="maze1")
    parser.add_argument(
        "--tolerances", type=float, nargs="+", default=[-1, 0.02, 0.05, 0.1, 0.2]
    )
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--decisions", type=int, default=1500)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    # One decision more than is played: no episode ends in between.
    settings = make_settings(arguments.run, arguments.maze, arguments.decisions + 1)
    places = make_goal_places(settings, *load_exploration(settings))
    env = make_navigation_env(
        settings, places, envs=arguments.episodes, seed=settings.seed
    )
    rows = []
    try:
        for tolerance in arguments.tolerances:
            knowledge, truth = load_exploration(settings)
            row = make_sparse(knowledge, truth, tolerance)
            navigator = make_policies(settings, knowledge, truth)[CHOSEN]
            env.set_seed(settings.seed)
            goals = play(env, navigator, arguments.decisions, name=f"{tolerance:g}")
            rate = bootstrap((goals * 1000 / arguments.decisions).tolist())
            row["goals_per_1000"] = [rate.value, rate.low, rate.high]
            rows.append(row)
            print(json.dumps(row), flush=True)
    finally:
        env.close()
    entries = {
        "run": Path(arguments.run).name,
        "episodes": arguments.episodes,
        "decisions": arguments.decisions,
        "maps": rows,
        "load": os.getloadavg()[0],
    }
    words = json.dumps(entries, indent=2)
    print(words)
    if arguments.out:
        arguments.out.write_text(words + "\n")


if __name__ == "__main__":
    main()
