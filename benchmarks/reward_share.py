"""Which share of waypoints the reward's threshold is calibrated to, and what it pays.

    python benchmarks/reward_share.py --networks runs/pretrain/select-... --out x.json

For each target share, the threshold is calibrated on random walks in the maze
``select`` (`calibrate_share`), as a pre-training does. The scripted walks of
``reward_guards.py`` then play in ``select`` and in generated mazes, never in those that
results are reported for, and their rewards are computed again with each threshold
(alpha 0.2, the default's guards). A good share pays for coverage: what an episode is
paid correlates with the share of the cells that it saw, and a walk that covers
little earns little beside an expert who sees every cell.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tqdm import tqdm

from toponav.builders import World, load_networks
from toponav.config import ExploreConfig
from toponav.graph import WalkWaypoints, calibrate_share
from toponav.keys import COVERAGE
from toponav.methods import make_world
from toponav.metrics import correlation

sys.path.append(str(Path(__file__).parent))
from reward_guards import VIEW, compute_rewards, make_policies, make_settings, record

#: Percent of the views of a random walk.
SHARES = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 12.5)


def play(
    settings: ExploreConfig, world: World, networks_path: str, *, episodes: int
) -> dict[str, list[TensorDictBase]]:
    """What the scripted policies saw, by their names."""
    networks = load_networks(networks_path)
    policies = make_policies(world, settings.seed).items()
    return {
        name: record(settings, world, networks, policy, episodes=episodes)
        for name, policy in policies
    }


def main() -> None:
    """Play, calibrate, compute the rewards, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--networks", required=True)
    parser.add_argument("--generated", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=6)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    networks = load_networks(options.networks)
    mazes = [["maze=select"]]
    mazes += [["maze=random", f"maze.seed={seed}"] for seed in range(options.generated)]
    rows, walks = [], []
    for words in mazes:
        settings = make_settings(*words, seed=0).resolved(networks.model)
        world = make_world(settings)
        played = play(settings, world, options.networks, episodes=options.episodes)
        # All policies' episodes side by side, the policies one after the other.
        seen = [torch.cat(one) for one in zip(*played.values(), strict=True)]
        if not walks:
            views = torch.stack([one[VIEW] for one in played["random"]], 1)
            walks = [WalkWaypoints(walk.flatten(1), networks.tc) for walk in views]
        coverage = seen[-1][COVERAGE].flatten()
        cells = coverage * len(world.layout.cells)
        for share in tqdm(SHARES, desc=" ".join(words)):
            found = calibrate_share(walks, target_share=share / 100)
            reward = replace(settings.reward, threshold=str(found.threshold))
            _, sums = compute_rewards(
                replace(settings, reward=reward), world, networks, seen
            )
            returns, waypoints, spurious = sums.unflatten(1, (len(played), -1))
            expert = returns[0].mean()
            row = {
                "maze": " ".join(words),
                "share (%)": share,
                "threshold": found.threshold,
                "correlation": correlation(returns.flatten(), coverage),
                "waypoints for a cell": float(waypoints.sum() / cells.sum()),
                "spurious (%)": float(100 * spurious.sum() / waypoints.sum()),
            }
            for name, part in zip(list(played)[1:], returns[1:], strict=True):
                row[f"{name} / expert"] = float(part.mean() / expert)
            rows.append({name: rounded(value) for name, value in row.items()})
            print(json.dumps(rows[-1]))
    if options.out:
        lines = ",\n".join(json.dumps(row) for row in rows)
        options.out.write_text(f'{{"rows": [\n{lines}\n]}}\n')


def rounded(value: object) -> object:
    """Three decimal places of a number."""
    return round(value, 3) if isinstance(value, float) else value


if __name__ == "__main__":
    main()
