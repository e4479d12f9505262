r"""What views of a map say of the free ground before the agent, drawn beside them.

    python benchmarks/ground_views.py runs/explore/select-... --out results/ground.png

Views are those of some waypoints of the run's map, drawn at random. Beside each is what
its `GroundNetwork` says: the agent stands at the bottom and looks up, and a spot is the
darker the less likely it is free. The network was trained on where agents walked; no
depth or plan is behind it.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from matplotlib.figure import Figure
from omegaconf import OmegaConf

from toponav.builders import AgentKnowledge, load_exploration
from toponav.config import NavigateConfig
from toponav.graph.poses import BEARINGS, DISTANCES
from toponav.methods import register
from toponav.plotting import save_figure

CONF = Path(__file__).resolve().parent.parent / "conf"
_COLUMNS = 4


def read_knowledge(run: Path) -> AgentKnowledge:
    """What the agent of an exploration knows."""
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        found = OmegaConf.to_object(compose("navigate", overrides=[f"run={run}"]))
    assert isinstance(found, NavigateConfig)
    knowledge, _ = load_exploration(found)
    return knowledge


def draw(knowledge: AgentKnowledge, *, number: int, seed: int) -> Figure:
    """Views and what is seen in them, ``number`` pairs."""
    assert knowledge.map_networks is not None
    assert knowledge.map_networks.ground is not None
    waypoints = knowledge.map.waypoints
    draws = torch.Generator().manual_seed(seed)
    chosen = torch.randperm(len(waypoints), generator=draws)[:number].tolist()
    with torch.no_grad():
        chance = knowledge.map_networks.ground(waypoints.embeddings[chosen]).sigmoid()
    rows = -(-number // _COLUMNS)
    figure = Figure(figsize=(2.6 * _COLUMNS, 3.1 * rows), layout="constrained")
    parts = figure.subplots(2 * rows, _COLUMNS, squeeze=False)
    # Edges of the fan: half a bearing and half a distance beside each spot, with the
    # agent's left on the left.
    half = float(BEARINGS[1] - BEARINGS[0]) / 2
    angle = np.deg2rad(np.append(BEARINGS - half, BEARINGS[-1] + half) + 90)
    step = float(DISTANCES[1] - DISTANCES[0]) / 2
    far = np.append(DISTANCES - step, DISTANCES[-1] + step)
    east, north = np.cos(angle)[:, None] * far, np.sin(angle)[:, None] * far
    for place, (node, seen) in enumerate(zip(chosen, chance.numpy(), strict=True)):
        row, column = 2 * (place // _COLUMNS), place % _COLUMNS
        above, below = parts[row][column], parts[row + 1][column]
        above.imshow(waypoints.images[node].numpy())
        above.set_title(f"view of waypoint {node}", fontsize=8)
        mesh = below.pcolormesh(east, north, seen, cmap="gray", vmin=0, vmax=1)
        below.plot(0, 0, "^", color="tab:red")
        below.set_aspect("equal")
        below.set_xlabel("steps", fontsize=7)
        below.tick_params(labelsize=6)
    for axes in parts[0::2].flat:
        axes.set_axis_off()
    figure.colorbar(mesh, ax=parts[1::2, -1].tolist(), label="chance that it is free")
    return figure


def main() -> None:
    """Draw one figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--number", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    knowledge = read_knowledge(options.run)
    if knowledge.map_networks is None or knowledge.map_networks.ground is None:
        parser.error(f"run must have a map that sees the ground, got '{options.run}'")
    save_figure(draw(knowledge, number=options.number, seed=options.seed), options.out)


if __name__ == "__main__":
    main()
