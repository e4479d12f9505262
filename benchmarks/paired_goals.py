"""Two evaluations of the same episodes, episode by episode: which reaches more goals?

    python benchmarks/paired_goals.py runs/navigate/handled runs/navigate/off

Both are run folders of ``recipes/navigate.py`` with the same maze, seed and closed
slots: then episodes of the same number have the same starts and the same goal, so that
their differences say more than the difference of two means. Printed are the mean
difference of the navigator's goals with its 95 % bootstrap interval, and how many
episodes reach more and fewer in the first run.
"""

import argparse
import csv
import json
from pathlib import Path

from toponav.metrics import bootstrap


def read_goals(folder: Path) -> list[int]:
    """Goals of the navigator's episodes, in their order."""
    with (folder / "episodes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["policy"] == "navigator"]
    return [int(row["goals"]) for row in rows]


def main() -> None:
    """Compare two runs and print what came out."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    for folder in (arguments.first, arguments.second):
        if not (folder / "episodes.csv").is_file():
            parser.error(f"a run must have its episodes.csv, got none in '{folder}'")
    first, second = read_goals(arguments.first), read_goals(arguments.second)
    if len(first) != len(second) or not first:
        parser.error(
            "both runs must have the same number of navigator's episodes, got "
            f"{len(first)} and {len(second)}"
        )
    more = [one - other for one, other in zip(first, second, strict=True)]
    mean = bootstrap(more)
    entries = {
        "first": arguments.first.name,
        "second": arguments.second.name,
        "episodes": len(more),
        "more_goals": [mean.value, mean.low, mean.high],
        "more_in": sum(difference > 0 for difference in more),
        "fewer_in": sum(difference < 0 for difference in more),
    }
    words = json.dumps(entries, indent=2)
    print(words)
    if arguments.out:
        arguments.out.write_text(words + "\n")


if __name__ == "__main__":
    main()
