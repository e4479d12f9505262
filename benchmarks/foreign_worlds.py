r"""What an explorer sees of worlds that are not ours, beside random walks.

    python benchmarks/foreign_worlds.py --out results/foreign_worlds.csv \
        --figure results/foreign_worlds.png
    python benchmarks/foreign_worlds.py --worlds minigrid --seeds 0 1 2

``recipes/explore.py world=gym`` pre-trains on random walks of the world, whose networks
all seeds share, explores with the novelty reward, and grows a map; it counts the
squares that an episode enters, of the best and the last policy, of uniformly random
actions, and of sticky ones, which mostly go on with what they did. Then
``recipes/navigate.py`` shows pictures from squares that a walk has entered, and counts
the episodes that come there, over the map and at random. A row is a policy of a run.
Other words are settings of the exploration.

Runs that are finished are not made again. The worlds need the extra ``worlds``.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd

from toponav.metrics import bootstrap
from toponav.plotting import draw_sweep, save_figure

ROOT = Path(__file__).resolve().parent.parent
#: Settings of each world beside ``world=gym``. Episodes end with the world's own limit
#: unless that is moved to the recipe's 500 decisions.
WORLDS = {
    "minigrid": (
        "world.id=MiniGrid-FourRooms-v0",
        "world.wrappers=[minigrid.wrappers.RGBImgPartialObsWrapper]",
        "world.actions=[0,1,2]",
        "world.options=[max_steps:500]",
        "world.position=[agent_pos.0,agent_pos.1]",
    ),
    "miniworld": (
        "world.id=MiniWorld-MazeS3-v0",
        "world.options=[max_episode_steps:500]",
        "world.position=[agent.pos.0,agent.pos.2]",
    ),
}
#: Shorter than the default: views are small, and so are the worlds.
SETTINGS = (
    *("world=gym", "world.reset_seed=0", "collect.decisions=100000"),
    "pretraining.overrides=['train.updates=500','train.warmup=50']",
    "locomotion.updates=1500",
)
#: Episodes with a picture each.
EPISODES = 100
SQUARES, PICTURES = "squares entered in an episode", "pictures walked to (%)"


def run(recipe: str, folder: Path, words: list[str], last: str) -> None:
    """Run a recipe with its words in a log beside its folder, unless ``last`` is there.

    ``last`` is a file that the recipe writes near its end; what one that was cut off
    has left goes.
    """
    if (folder / last).is_file():
        return
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, str(ROOT / "recipes" / recipe), *words]
    with Path(f"{folder}.log").open("w") as log:
        done = subprocess.run(
            [*command, f"hydra.run.dir={folder}"],
            stdout=log,
            stderr=subprocess.STDOUT,
            check=False,
        )
    if done.returncode:
        raise SystemExit(f"{folder}.log: exit status {done.returncode}")


def measure(
    world: str, seed: int, work: Path, overrides: list[str]
) -> list[dict[str, Any]]:
    """The rows of one world and seed."""
    folder = work / f"{world}-{seed}"
    words = [*SETTINGS, *WORLDS[world], f"seed={seed}"]
    words += [f"pretraining.folder={work / 'pretrain'}", *overrides]
    run("explore.py", folder, words, "evaluation.csv")
    walked = Path(f"{folder}-navigate")
    words = [f"run={folder}", "navigator=topological", f"seed={seed}"]
    run("navigate.py", walked, [*words, f"evaluate.episodes={EPISODES}"], "summary.csv")
    played = {
        SQUARES: pd.read_csv(folder / "evaluation.csv").groupby("policy")["places"],
        PICTURES: pd.read_csv(walked / "episodes.csv").groupby("policy")["reached"],
    }
    rows = []
    for name, policies in played.items():
        for policy, values in policies:
            scale = 100.0 if name == PICTURES else 1.0
            found = bootstrap(scale * values.to_numpy())
            rows.append(
                {
                    **{"world": world, "seed": seed, "measure": name},
                    **{"policy": policy, "episodes": len(values)},
                    "mean": round(found.value, 1),
                    "low": round(found.low, 1),
                    "high": round(found.high, 1),
                }
            )
    return rows


def main() -> None:
    """Make the runs, print and write the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--work", type=Path, default=Path("runs/foreign_worlds"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("overrides", nargs="*", help="more settings, as for the recipe")
    options = parser.parse_args()
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for world in options.worlds:
        for seed in options.seeds:
            rows += measure(world, seed, work, options.overrides)
            table = pd.DataFrame(rows)
            print(
                table[(table["world"] == world) & (table["seed"] == seed)], flush=True
            )
            if options.out:
                table.to_csv(options.out, index=False, lineterminator="\n")
    if options.figure:
        table = pd.DataFrame(rows)
        shown = pd.DataFrame(
            {
                "panel": table["world"] + ": " + table["measure"],
                "line": "policy",
                "at": table["policy"],
                "value": table["mean"],
            }
        )
        figure = draw_sweep(shown, x="policy", label="", same_y=False)
        save_figure(figure, options.figure)


if __name__ == "__main__":
    main()
