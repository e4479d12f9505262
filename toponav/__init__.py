"""Curiosity-driven exploration, topological maps and navigation in 3-D mazes."""

import os

# Threads that compute together soon sleep while they wait for each other. By default
# they spin for long, and where engines want the same cores an operation then takes ten
# times as long; without any spinning a pre-training alone on two cores takes a tenth
# longer. It is read when torch is loaded.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")

__version__ = "0.1.0.dev0"
