"""Curiosity-driven exploration, topological maps and navigation in 3-D mazes."""

import os

# Threads that compute together sleep while they wait for each other. By default they
# spin, and where engines want the same cores an operation then takes ten times as long.
# It is read when torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0.dev0"
