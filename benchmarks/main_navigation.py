"""One row for each policy of each navigation of a main job, from the files of its run.

    python benchmarks/main_navigation.py runs/navigate/maze1-... \
        --against results/main_navigation.csv --out results/main_navigation.csv

Goals are of an episode, with 95 % bootstrap intervals over episodes; ``cuts`` is the
mean number of times that edges were closed in one, ``success_<n>`` the share of the
episodes that reached a goal within so many decisions, and ``detection_delay`` the
median of the decisions from standing before a closed corridor to its closing.
``pictures`` says where goal views come from, the map or a walk, and ``closes`` whether
the navigator closes edges. Of all cuts of a row, ``cuts_blockage`` were at a closed
corridor, ``cuts_false_edge`` at an edge through a wall, and ``cuts_false_block``
closed what is open. ``--against`` prints, in pairs of the same maze, slots and
seed, how many goals more the navigator reaches than in former rows.
"""

import argparse
from pathlib import Path

import pandas as pd
from pose_maps import read_settings

from toponav.config import maze_label, read_yaml

TOLD = ["maze", "seed", "closed", "pictures", "closes"]
SHOWN = ["goals", "goals_low", "goals_high", "cuts", "success_1250", "success_5000"]
SUCCESS = SHOWN[-2:]  # of 30 episodes one is 0.033
SHOWN += ["cuts_blockage", "cuts_false_edge", "cuts_false_block", "detection_delay"]


def read_tour(folder: Path) -> pd.DataFrame:
    """The rows of a navigation's run folder."""
    given = read_yaml(folder / "config" / "config.yaml")
    explored = read_settings(Path(given["run"]))
    table = pd.read_csv(folder / "summary.csv").rename(columns={"replans": "cuts"})
    maze = explored.maze
    table["maze"], table["seed"] = maze_label(maze.name, maze.path), explored.seed
    table["closed"] = "".join(given["maze"]["blocked"]) or "nothing"
    table["pictures"] = given["goals"]["source"]
    closes = given["navigator"].get("block_after") is not None
    table["closes"] = "yes" if closes else "no"
    table["decisions"] = given["maze"]["episode_length"]
    table[SHOWN] = table[SHOWN].round(1).assign(**table[SUCCESS].round(3))
    return table[[*TOLD, "policy", "episodes", "decisions", *SHOWN]]


def compare(rows: pd.DataFrame, former: pd.DataFrame) -> pd.DataFrame:
    """Goals of the navigator now and before, and the mean difference over the seeds."""
    now, before = (
        one[one["policy"] == "navigator"].set_index(TOLD)["goals"]
        for one in (rows, former)
    )
    both = pd.DataFrame({"now": now, "before": before}).dropna()
    both["more"] = both["now"] - both["before"]
    found: pd.DataFrame = both.groupby(["maze", *TOLD[2:]]).mean().round(1)
    return found


def main() -> None:
    """Print the rows, and keep them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = pd.concat([read_tour(run) for run in options.runs], ignore_index=True)
    print(rows.to_string())
    if options.against:
        print(compare(rows, pd.read_csv(options.against)).to_string())
    if options.out:
        rows.to_csv(options.out, index=False, lineterminator="\n")


if __name__ == "__main__":
    main()
