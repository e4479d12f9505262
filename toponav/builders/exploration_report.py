"""`ExplorationReport`: what a run says while it explores."""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from toponav.builders.episode_log import EpisodeLog, Row
from toponav.builders.exploration_files import make_metrics, write_metrics
from toponav.builders.exploration_pictures import write_map, write_training_curves
from toponav.builders.exploration_state import ExplorationState
from toponav.builders.run_files import make_loggers
from toponav.config import ExploreConfig


class ExplorationReport:
    """Collects measurements, writes rows and pictures, and keeps the live line.

    Args:
        config: settings of the run.
        folder: the run folder.
        state: counters and tables; rows are added to it.
        log: finished episodes.
        bar: the live line; counts decisions.
    """

    def __init__(
        self,
        config: ExploreConfig,
        folder: Path,
        state: ExplorationState,
        log: EpisodeLog,
        bar: tqdm,
    ) -> None:
        self.config = config
        self.folder = folder
        self.state = state
        self.log = log
        self.bar = bar
        self.loggers = make_loggers(folder)
        self._means = Means()
        self._ended: list[Row] = []
        self._lr = 0.0

    def add(
        self, measured: Mapping[str, float], ended: Sequence[Row], *, lr: float
    ) -> None:
        """Count the measurements of a batch and the episodes that it finished."""
        self._means.add(measured)
        self._ended += ended
        self._lr = lr

    def is_due(self) -> bool:
        """Whether ``report.every`` decisions have been made since the last row."""
        since = self.state.history[-1]["decisions"] if self.state.history else 0
        due: bool = self.state.decisions - since >= self.config.report.every
        return due

    def write_row(self) -> None:
        """Write a row of metrics, and put its gist on the live line."""
        state = self.state
        last = state.history[-1] if state.history else {"decisions": 0, "seconds": 0.0}
        seconds = max(state.seconds - last["seconds"], 1e-9)
        counts = {
            "decisions": state.decisions,
            "seconds": state.seconds,
            "decisions_per_second": (state.decisions - last["decisions"]) / seconds,
            "lr": self._lr,
            "policy_version": state.policy_version,
            "networks_version": state.networks_version,
        }
        row = make_metrics(counts, self._ended, self.log.rows, self._means.take())
        self._ended = []
        state.history.append(row)
        write_metrics(self.folder, self.loggers, state.history, self.log.rows)
        self.bar.set_postfix_str(gist(row))

    def draw(self) -> None:
        """Renew the pictures."""
        maze = self.config.maze
        write_training_curves(
            self.folder,
            self.state.history,
            self.log.rows,
            levels=self.state.levels,
            title=maze.name,
        )
        if self.log.last_episode is not None:
            write_map(self.folder, maze, self.log.last_episode)


def gist(row: Row) -> str:
    """A row of metrics for the live line; before the first episode ended, its losses.

    Examples:
        >>> row = {"loss_objective": -0.004, "loss_critic": 0.1, "entropy": 1.75}
        >>> gist(row | {"episodes": 0, "coverage": math.nan})
        'objective -0.004, critic 0.100, entropy 1.75'
    """
    losses = (
        f"objective {row['loss_objective']:.3f}, critic {row['loss_critic']:.3f}, "
        f"entropy {row['entropy']:.2f}"
    )
    if math.isnan(row["coverage"]):
        return losses
    return (
        f"coverage {row['coverage']:.0%}, waypoints {row['waypoints']:.0f}, "
        f"return {row['intrinsic_return']:.0f}, {losses}"
    )


class Timer:
    """Says when it is time again.

    Args:
        seconds: from one time to the next.

    Examples:
        >>> Timer(1e-9).is_due(), Timer(60).is_due()
        (True, False)
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._last = time.monotonic()

    def is_due(self) -> bool:
        """Whether it is; if so, the next time is counted from now."""
        now = time.monotonic()
        if now - self._last < self.seconds:
            return False
        self._last = now
        return True


class Means:
    """Means of measurements, until they are taken.

    Examples:
        >>> means = Means()
        >>> means.add({"loss": 1.0})
        >>> means.add({"loss": 3.0})
        >>> means.take(), means.take()
        ({'loss': 2.0}, {})
    """

    def __init__(self) -> None:
        self._values: dict[str, list[float]] = {}

    def add(self, measured: Mapping[str, float]) -> None:
        """Count one measurement."""
        for name, value in measured.items():
            self._values.setdefault(name, []).append(value)

    def take(self) -> Row:
        """The means so far; what follows starts anew."""
        means = {name: sum(all_) / len(all_) for name, all_ in self._values.items()}
        self._values = {}
        return means
