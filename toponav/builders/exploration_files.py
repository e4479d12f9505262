"""What an exploration writes into its run folder, beside networks and checkpoints."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchrl.record.loggers import Logger

from toponav.builders.episode_log import Row, mean_of
from toponav.builders.run_files import write_history
from toponav.evaluation import correlation

#: Means over the episodes that ended since the last row.
_EPISODE_MEANS = (
    "coverage",
    "intrinsic_return",
    "count_return",
    "temporal_distance_return",
    "births",
    "false_births",
    "waypoints",
)
#: Episodes over which return and coverage are correlated.
_CORRELATED = 100


def make_metrics(
    counts: Row,
    episodes: Sequence[Row],
    all_episodes: Sequence[Row],
    measured: Mapping[str, float],
) -> Row:
    """A row of ``metrics.csv``.

    Args:
        counts: decisions, seconds and their rate; versions; the learning rate.
        episodes: those that ended since the last row.
        all_episodes: those of the run so far.
        measured: losses, means since the last row; those that are missing are NaN.
    """
    last = all_episodes[-_CORRELATED:]
    returns = [row["intrinsic_return"] for row in last]
    coverage = [row["coverage"] for row in last]
    names = ("loss_objective", "loss_critic", "loss_entropy", "entropy")
    online = ("loss_tc", "loss_locomotion")
    return {
        "decisions": counts["decisions"],
        "seconds": counts["seconds"],
        "decisions_per_second": counts["decisions_per_second"],
        "episodes": len(all_episodes),
        **{name: mean_of(episodes, name) for name in _EPISODE_MEANS},
        "return_coverage_correlation": correlation(returns, coverage),
        **{name: measured.get(name, math.nan) for name in names},
        "lr": counts["lr"],
        "policy_version": counts["policy_version"],
        "networks_version": counts["networks_version"],
        **{name: measured.get(name, math.nan) for name in online},
    }


def write_metrics(
    folder: Path,
    loggers: Sequence[Logger],
    history: Sequence[Row],
    episodes: Sequence[Row],
) -> None:
    """Log the last row, and write ``metrics.csv`` and ``episodes.csv`` whole.

    Args:
        folder: the run folder.
        loggers: get every number under ``explore/<name>``.
        history: rows so far.
        episodes: finished episodes so far.
    """
    last = history[-1]
    named = {
        f"explore/{name}": value for name, value in last.items() if math.isfinite(value)
    }
    for logger in loggers:
        logger.log_metrics(named, step=int(last["decisions"]))
    write_history(folder / "metrics.csv", history)
    if episodes:
        write_history(folder / "episodes.csv", episodes)
