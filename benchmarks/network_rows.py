"""One row for each pre-training: how well its networks judge held-out episodes.

    python benchmarks/network_rows.py runs/pretrain/... --out network_accuracy.csv

Figures are those of ``report.json``, in %, of the maze that the walks were in; what
they mean: `toponav.metrics`. ``l_useful_1`` to ``l_useful_4`` are the shares of pairs
as many decisions apart in which the L-network's most probable action leads nearer.
"""

import argparse
import json
from pathlib import Path

import pandas as pd
from omegaconf import OmegaConf

#: What the columns are called, and the figures in ``report.json``.
FIGURES: dict[str, str] = {
    "tc_accuracy": "accuracy",
    "tc_positives": "positive_accuracy",
    "tc_negatives": "negative_accuracy",
    "tc_auc": "auc",
    "true_poses": "pose_bound",
    "calibration_error": "calibration_error",
    "place_error": "place_error",
    "place_error_revisit": "place_error_revisit",
    **{f"l_accuracy_{apart}": f"accuracy_{apart}" for apart in range(1, 5)},
    **{f"l_useful_{apart}": f"useful_argmax_{apart}" for apart in range(1, 5)},
}


def read_run(run: Path) -> list[dict[str, object]]:
    """The rows of a run folder that has its report, one for each of its mazes."""
    seed = OmegaConf.load(run / "config" / "config.yaml").seed
    report = json.loads((run / "report.json").read_text())["mazes"]
    return [
        {"maze": maze, "seed": seed}
        | {name: round(100 * of[figure], 2) for name, figure in FIGURES.items()}
        for maze, of in report.items()
    ]


def main() -> None:
    """Print the rows, and keep them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = pd.DataFrame([row for run in options.runs for row in read_run(run)])
    rows = rows.sort_values(["maze", "seed"])
    print(rows.to_string(index=False))
    if options.out:
        rows.to_csv(options.out, index=False, lineterminator="\n")


if __name__ == "__main__":
    main()
