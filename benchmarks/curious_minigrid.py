"""The example on MiniGrid with several seeds: what it prints, as a table and a figure.

    python benchmarks/curious_minigrid.py --out results/curious_minigrid.csv

Each run of ``examples/curious_minigrid.py`` is added whole to the table, and one that
is there is not made twice. The figure beside it has a panel for exploring and one for
walking to pictures, with the mean and the range of the seeds and what random walks do.
Those mostly go ahead; the last line says how many squares uniform actions enter.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd

from toponav.plotting import draw_learning_curves, save_figure
from toponav.policies import RandomPolicy

sys.path.append(str(Path(__file__).resolve().parent.parent / "examples"))
from painted_rooms import count_squares, make_env

EXAMPLE = Path(sys.path[-1]) / "curious_minigrid.py"

BATCH, NUM_SQUARES = 4096, 260  # decisions; squares of the rooms
UNIFORM_WALKS = 2**7
COLUMNS = ["seed", "part", "decisions", "agent", "random"]


def read_lines(said: str) -> list[tuple[str, int, float, float]]:
    """Part, decisions and the numbers of agent and random walks in what a run prints.

    The random share of pairs that are right is that of a coin.
    """
    (right,) = re.findall(r"TC-network: ([\d.]+)%", said)
    rows = [("pairs right (%)", 0, float(right), 50.0)]
    explored = re.findall(r"explorer: ([\d.]+) squares, random: ([\d.]+)", said)
    for number, (agent, random) in enumerate(explored, start=1):
        rows.append(("squares", BATCH * number, float(agent), float(random)))
    arrived = r"after (\d+) decisions: by the map (\d+)%, at random (\d+)%"
    for decisions, agent, random in re.findall(arrived, said):
        rows.append(("pictures (%)", int(decisions), float(agent), float(random)))
    return rows


def curves_of(
    rows: pd.DataFrame, column: str, scale: float
) -> list[tuple[object, object]]:
    """Of each seed decisions and values of a column."""
    return [
        (own["decisions"].to_numpy(float), scale * own[column].to_numpy(float))
        for _, own in rows.groupby("seed")
    ]


def draw(table: pd.DataFrame, path: Path) -> None:
    """Write the figure of all runs in the table."""
    explored = table[table["part"] == "squares"]
    walked = table[table["part"] == "pictures (%)"]
    share = 100 / NUM_SQUARES
    panels = {
        "Squares entered in an episode": {
            "explorer": curves_of(explored, "agent", share),
            "random walk": curves_of(explored, "random", share),
        },
        "Pictures that were walked to": {
            "over the map": curves_of(walked, "agent", 1),
            "random walk": curves_of(walked, "random", 1),
        },
    }
    figure = draw_learning_curves(panels, {}, label="")
    ys = f"of {NUM_SQUARES} squares (%)", "of 64 pictures (%)"
    xs = "decisions of the exploration", "decisions since the start"
    for axes, x, y in zip(figure.axes, xs, ys, strict=True):
        axes.set_xlabel(x)
        axes.set_ylabel(y)
    save_figure(figure, path)


def main() -> None:
    """Run the example with the seeds that are not in the table yet, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    options = parser.parse_args()
    out = options.out
    table = pd.read_csv(out) if out.exists() else pd.DataFrame(columns=COLUMNS)
    for seed in options.seeds:
        if seed in set(table["seed"]):
            continue
        words = [sys.executable, str(EXAMPLE), f"--seed={seed}"]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        rows = pd.DataFrame([(seed, *row) for row in read_lines(said)], columns=COLUMNS)
        table = pd.concat([table, rows]) if len(table) else rows
        table.to_csv(out, index=False)
        print(said.splitlines()[-1], flush=True)
    draw(table, out.with_suffix(".png"))
    env = make_env(envs=UNIFORM_WALKS, length=256, seed=0)
    entered = count_squares(
        env.rollout(256, RandomPolicy(3), break_when_any_done=False)
    )
    share = entered / NUM_SQUARES
    print(f"uniform actions: {entered:.1f} of {NUM_SQUARES} squares ({share:.1%})")


if __name__ == "__main__":
    main()
