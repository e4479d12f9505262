r"""Puts the networks of pre-trainings into the package, as ``package:<maze>``.

    python recipes/pretrain.py -m maze=maze1,maze2,select model=tiny \
        train.updates=600 collect.decisions=80896 train.threads=1
    python recipes/pretrain.py maze=maze3 model=tiny \
        train.updates=1000 collect.decisions=100352 train.threads=1
    python benchmarks/package_networks.py <the sweep> <the run>

The weights are rounded to float16 and computed with in float32; thresholds are kept as
they are. What was put there is measured as any networks are, and `recipes/report.py`
makes a table of it:

    python recipes/pretrain.py -m maze=maze1,maze2,maze3,select model=tiny
      'init_from=package:${maze.name}' train.updates=0
"""

import argparse
from pathlib import Path

from toponav.builders import (
    NETWORKS_FILE,
    PACKAGE_NETWORKS,
    load_networks,
    save_networks,
)
from toponav.config import read_yaml


def main() -> None:
    """Convert every pre-training in the given folders."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="runs or sweeps")
    for folder in parser.parse_args().folders:
        for run in sorted(one.parent for one in folder.rglob(NETWORKS_FILE)):
            maze = read_yaml(run / "config/config.yaml").maze.name
            path = PACKAGE_NETWORKS / f"{maze}.pt"
            save_networks(load_networks(run), path, half=True)
            print(f"{path} of {run}, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
