"""Curiosity-driven exploration, topological maps and navigation in 3-D mazes."""

__version__ = "0.1.0.dev0"
