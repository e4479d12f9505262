"""One row for each exploration: coverage, time and map, from the files of its run.

    python benchmarks/main_rows.py runs/explore/maze1-... --out results/main_rows.csv

Coverage by the name of a policy (``best``, ``last``, ...) is in % of the maze, of those
that the run evaluated at its end. Decisions to 90 % are of the episodes that reached
it; of the policy that the run kept (``kept``) also with those that missed it, as if
they had reached it at their end. Minutes are those of the phases. ``networks`` is the
maze that the networks were trained in, or the name of their file. ``--settings
collect.envs`` adds a column. The map, if there is one, is that of the last row of
``map.csv``, and ``coverage`` the share of the cells, in [0, 1], in which one of its
waypoints lies. Beside ``decisions_to_cover``, the decisions of the run until its map
covered every cell, stand those of random walks in its place (mean of three seeds):
until the agents that feed the map have seen every cell, in decisions of all agents.
"""

import argparse
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from omegaconf import OmegaConf
from pose_maps import read_settings
from torchrl.envs import InitTracker, TransformedEnv

from toponav.builders import collect_rollout, make_layout, networks_path
from toponav.config import ExploreConfig, maze_label
from toponav.envs import Layout, MazeEnv
from toponav.keys import CELL
from toponav.policies import RandomPolicy

MAP = (
    *("coverage", "first_waypoint_share", "last_waypoint_share", "false_edges"),
    *("false_paths", "missing_edges", "true_components", "stretch"),
    "decisions_to_cover",
)
#: What the columns of minutes are called, and the phases in ``phases.csv``.
PHASES = {
    "pretrain": "pre-train",
    "explore": "explore",
    "finish": "evaluate and finish map and networks",
}


@cache
def random_to_cover(layout: Layout, fed: int, envs: int, length: int, seed: int) -> int:
    """Decisions until random walks have seen every cell, as described above."""
    base = MazeEnv(
        layout, batch_size=fed, privileged=True, seed=seed, episode_length=length + 1
    )
    policy = RandomPolicy(base.world.num_actions, seed=seed)
    env = TransformedEnv(base, InitTracker())
    seen, steps = torch.from_numpy(~layout.open_mask), 0
    try:
        while not seen.all():
            played = collect_rollout(env, policy, length, keep=(CELL,), keep_next=())
            # [steps, agents, row and column]
            for cells in played.frames[CELL].transpose(0, 1):
                if seen.all():
                    break
                seen[tuple(cells.unbind(-1))] = True
                steps += 1
    finally:
        env.close()
    return steps * envs


def read_run(run: Path, shown: Sequence[str] = ()) -> dict[str, object]:
    """The row of a run folder that was evaluated, with these of its settings."""
    settings = read_settings(run)
    maze = maze_label(settings.maze.name, settings.maze.path)
    row: dict[str, object] = {"maze": maze, "seed": settings.seed}
    if shown:
        saved = OmegaConf.load(run / "config" / "config.yaml")
        row |= {name: OmegaConf.select(saved, name) for name in shown}
    row["networks"] = trained_in(settings) or maze
    row["decisions"] = int(pd.read_csv(run / "metrics.csv")["decisions"].iloc[-1])
    row |= of_policies(run, settings.maze.episode_length)
    phases = pd.read_csv(run / "phases.csv").set_index("phase")["seconds"]
    for name, phase in PHASES.items():
        row[f"minutes_{name}"] = round(phases.get(phase, np.nan) / 60, 1)
    return row | of_map(run, settings) if (run / "map.csv").is_file() else row


def trained_in(settings: ExploreConfig) -> str | None:
    """What the maze of its networks is called; ``None`` is its own."""
    if settings.pretrained is None:
        return settings.pretraining.maze
    given = networks_path(settings.pretrained)
    config = (given if given.is_dir() else given.parent) / "config" / "config.yaml"
    if not config.is_file():  # one that came with the package, or was copied
        return given.stem
    maze = OmegaConf.load(config).maze
    return maze_label(maze.name, maze.path)


def of_policies(run: Path, length: int) -> dict[str, object]:
    """What the policies cover in episodes of ``length`` decisions."""
    evaluation = pd.read_csv(run / "evaluation.csv")
    played = evaluation.groupby("policy")
    coverage = 100 * played["coverage"].mean()
    row: dict[str, object] = {}
    for name in ("best", "last", "random", "sticky"):
        if name in coverage:
            row[name] = round(coverage[name], 1)
    for name in ("best", "last"):
        to_90 = played.get_group(name)["decisions_to_90"]
        reached = to_90[to_90 >= 0]
        row[f"{name}_episodes_at_90"] = f"{len(reached)} of {len(to_90)}"
        row[f"{name}_decisions_to_90"] = round(reached.mean()) if len(reached) else -1
    # The policy with more reward comes first.
    kept = evaluation["policy"].iloc[0]
    to_90 = played.get_group(kept)["decisions_to_90"]
    row |= {"kept": kept, "kept_coverage": round(coverage[kept], 1)}
    row["kept_decisions_to_90_or_end"] = round(to_90.where(to_90 >= 0, length).mean())
    return row


def of_map(run: Path, settings: ExploreConfig) -> dict[str, object]:
    """The last row of its map, and how soon random walks would have fed one."""
    last = pd.read_csv(run / "map.csv").iloc[-1]
    row = {"waypoints_per_cell": round(last["waypoints"] / last["cells"], 1)}
    row |= {name: float(f"{last[name]:.4g}") for name in MAP}
    layout, envs = make_layout(settings.maze), settings.collect.envs
    given = layout, settings.map.envs or envs, envs, settings.maze.episode_length
    walked = [random_to_cover(*given, seed) for seed in range(3)]
    return row | {"random_decisions_to_cover": round(sum(walked) / 3)}


def main() -> None:
    """Print the rows, and keep them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--settings", nargs="+", default=[], metavar="NAME")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = pd.DataFrame([read_run(run, options.settings) for run in options.runs])
    print(rows.to_string())
    if options.out:
        rows.to_csv(options.out, index=False, lineterminator="\n")


if __name__ == "__main__":
    main()
