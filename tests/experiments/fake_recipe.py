"""A recipe that makes an exploration in no time; says how often it was started."""

import csv
import sys
import time
from pathlib import Path

from filelock import FileLock


def main() -> None:
    words = dict(word.partition("=")[::2] for word in sys.argv[1:])
    folder = Path((words.get("hydra.run.dir") or words["resume"]).strip("'"))
    (folder / "config").mkdir(parents=True, exist_ok=True)
    with FileLock(folder / "config" / ".lock", timeout=0):
        with (folder / "starts").open("a") as file:
            file.write("resume\n" if "resume" in words else "start\n")
        (folder / "config/config.yaml").write_text(
            "collect: {decisions: 100, minutes: null}\n"
        )
        (folder / "checkpoint.pt").touch()
        if words.get("bad"):
            sys.exit("explore: the engine must start, got nothing")
        # Until the test lets it go on.
        while words.get("wait") and not Path(words["wait"]).exists():
            time.sleep(0.01)
        tables = {
            "metrics": {"decisions": 100, "seconds": 1.5},
            "episodes": {"decisions": 100, "coverage": 0.5},
            "evaluation": {
                **{"policy": "last", "seed": 0, "coverage": 0.5},
                **{f"decisions_to_{level}": -1 for level in (50, 90, 100)},
            },
        }
        for name, row in tables.items():
            with (folder / f"{name}.csv").open("w", newline="") as file:
                table = csv.DictWriter(file, list(row))
                table.writeheader()
                table.writerow(row)


if __name__ == "__main__":
    main()
