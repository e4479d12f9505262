r"""What a practice found out about the edges of its map, and what the map is by that.

    python benchmarks/walked_edges.py <practices> --out results/walked_edges.csv

Rows are the map as its run left it and as a navigator plans on it after each practice
(`navigator.edge_trials`), judged by the truth that no agent sees; and how often trials
of true and of false edges passed.
"""

import argparse
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from torch import Tensor

from toponav.builders import GroundTruth, load_exploration, load_trials
from toponav.config import NavigateConfig
from toponav.graph import to_the_middle, walking_costs
from toponav.methods import register
from toponav.metrics import FALSE_EDGE_CELLS, edge_lengths, map_quality

CONF = Path(__file__).resolve().parent.parent / "conf"
_KEPT = ("edges", "false_edges", "false_paths", "missing_edges", "components")
_KEPT += ("true_components", "stretch")


def judge(truth: GroundTruth, edges: Tensor, cost: Tensor) -> dict[str, Any]:
    """Columns of a map with these edges ``[E, 2]``, and costs there and back."""
    found = map_quality(truth.distances, truth.poses, edges, cost.amin(1))
    return {name: round(getattr(found, name), 5) for name in _KEPT}


def rows_of(practice: Path) -> list[dict[str, Any]]:
    """The map before and after, and its trials."""
    run = OmegaConf.load(practice / "config" / "config.yaml")["run"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("navigate", overrides=[f"run={run}"]))
    assert isinstance(settings, NavigateConfig)
    knowledge, truth = load_exploration(settings)
    known, width = knowledge.map, vars(settings.navigator)["width"]
    edges = known.edges
    track = to_the_middle(known.waypoints.poses[:, :2], width=width)
    guess = walking_costs(track, edges, known.graph.traversals)
    trials = load_trials(practice, edges, setting="practice")
    cost, kept = trials.costs(guess), trials.kept(known.num_waypoints)
    lengths = edge_lengths(truth.distances, truth.poses, edges)
    far = lengths > FALSE_EDGE_CELLS * truth.distances.cell_size
    named = {"maze": truth.layout.name, "practice": practice.name}
    before = judge(truth, edges, guess.unsqueeze(1).expand(-1, 2))
    after = judge(truth, edges[kept], cost[kept])
    after |= {"passed": float(trials.confirmed.any(1).float().mean())}
    for name, some in (("true", ~far), ("false", far)):
        tried, passed = trials.tried[some].sum(), trials.passed[some].sum()
        after |= {f"trials_{name}": int(tried), f"success_{name}": passed / tried}
        after[f"left_out_{name}"] = int((~kept)[some].sum())
        after[f"cost_{name}"] = cost[some].amin(1).median()
    after = {name: float(value) for name, value in after.items()}
    return [{**named, "map": "as left", **before}, {**named, "map": "walked", **after}]


def main() -> None:
    """Write one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("practices", type=Path, nargs="+")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    register()
    torch.set_num_threads(1)
    table = pd.DataFrame([row for one in options.practices for row in rows_of(one)])
    print(table.T.to_string())
    if options.out is not None:
        table.round(4).to_csv(options.out, index=False)


if __name__ == "__main__":
    main()
