"""`ExplorationReport`: what a run shows while it explores."""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from toponav.builders import NETWORKS, POLICY, Consumer, World
from toponav.config import ExploreConfig
from toponav.metrics import correlation
from toponav.reports.exploration_pictures import write_map, write_training_curves
from toponav.runs import make_loggers, write_history
from toponav.training import EpisodeLog, ExplorationState, Row, mean_of

#: Episodes over which return and coverage are correlated.
_CORRELATED = 100


class ExplorationReport:
    """Collects measurements, writes rows and pictures, and keeps the progress bar.

    Args:
        settings: of the run.
        world: where it explores.
        folder: the run folder.
        state: counters and tables; rows are added to it.
        consumers: of the batches; they write their files too. Among them is the log of
            finished episodes.
    """

    def __init__(
        self,
        settings: ExploreConfig,
        world: World,
        folder: Path,
        state: ExplorationState,
        consumers: Mapping[str, Consumer],
    ) -> None:
        self.config = settings.report
        self.world = world
        self.folder = folder
        self.state = state
        self.consumers = consumers
        log = consumers["episodes"]
        assert isinstance(log, EpisodeLog)
        self.log = log
        self.loggers = make_loggers(folder)
        self.bar = tqdm(
            desc="explore",
            total=settings.collect.decisions,
            initial=state.decisions,
            unit="decision",
            smoothing=0.05,
        )
        self._drawing = Timer(self.config.pictures_every_s)
        self._means = Means()
        self._ended: list[Row] = []
        self._lr = 0.0

    def update(self, measured: Mapping[str, float], decisions: int) -> None:
        """Count a batch; write a row of metrics and pictures if it is time.

        Args:
            measured: losses and other figures of the batch.
            decisions: of the batch.
        """
        self._lr = measured.get("lr", self._lr)
        self._means.add(measured)
        self._ended += self.log.ended
        self.bar.update(decisions)
        is_last = self.state.progress == 1
        last = self.state.history[-1]["decisions"] if self.state.history else 0
        if is_last or self.state.decisions - last >= self.config.every:
            self._write_row()
        if is_last or self._drawing.is_due():
            self._draw()

    def close(self) -> None:
        """Leave the progress bar as it is."""
        self.bar.close()

    def _write_row(self) -> None:
        state, log = self.state, self.log
        last = state.history[-1] if state.history else {"decisions": 0, "seconds": 0.0}
        seconds = max(state.seconds - last["seconds"], 1e-9)
        row: Row = {
            "decisions": state.decisions,
            "seconds": state.seconds,
            "decisions_per_second": (state.decisions - last["decisions"]) / seconds,
            "episodes": len(log.rows),
            **{name: mean_of(self._ended, name) for name in (*log.ends, *log.sums)},
            **_correlate(log.rows[-_CORRELATED:]),
            **self._means.take(),
            # Of the last batch, not a mean.
            "lr": self._lr,
            "policy_version": state.versions.get(POLICY, 0),
            "networks_version": state.versions.get(NETWORKS, 0),
        }
        self._ended = []
        state.history.append(row)
        for logger in self.loggers:
            named = {f"explore/{name}": value for name, value in row.items()}
            logger.log_metrics(named, step=int(row["decisions"]))
        write_history(self.folder / "metrics.csv", state.history)
        if log.rows:
            write_history(self.folder / "episodes.csv", log.rows)
        self.bar.set_postfix_str(format_progress(row))

    def _draw(self) -> None:
        write_training_curves(
            self.folder,
            self.state.history,
            self.log.rows,
            levels=self.state.baselines,
            title=self.world.name,
        )
        if self.log.last_episode is not None and self.world.layout is not None:
            write_map(self.folder, self.world, self.log)
        for consumer in self.consumers.values():
            consumer.write(self.folder)


def _correlate(rows: Sequence[Row]) -> Row:
    if rows and "coverage" not in rows[0]:
        return {}
    returns = [row["intrinsic_return"] for row in rows]
    coverage = [row["coverage"] for row in rows]
    return {"return_coverage_correlation": correlation(returns, coverage)}


def format_progress(row: Row) -> str:
    """A row of metrics in a few words; before the first episode ended, its losses.

    Examples:
        >>> row = {"loss_objective": -0.004, "loss_critic": 0.1, "entropy": 1.75}
        >>> format_progress(row | {"intrinsic_return": math.nan})
        'objective -0.004, critic 0.100, entropy 1.75'
        >>> format_progress({"coverage": 0.5, "intrinsic_return": 70.2})
        'coverage 50%, return 70'
    """
    formats = {
        "coverage": ("coverage", ".0%"),
        "waypoints": ("waypoints", ".0f"),
        "intrinsic_return": ("return", ".0f"),
        "loss_objective": ("objective", ".3f"),
        "loss_critic": ("critic", ".3f"),
        "entropy": ("entropy", ".2f"),
    }
    return ", ".join(
        f"{label} {row[name]:{form}}"
        for name, (label, form) in formats.items()
        if not math.isnan(row.get(name, math.nan))
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
        ({'loss': 2.0}, {'loss': nan})
    """

    def __init__(self) -> None:
        self._values: dict[str, list[float]] = {}

    def add(self, measured: Mapping[str, float]) -> None:
        """Count one measurement."""
        for name, value in measured.items():
            self._values.setdefault(name, []).append(value)

    def take(self) -> Row:
        """The means since the last time; NaN where there was none."""
        means = {
            name: sum(values) / len(values) if values else math.nan
            for name, values in self._values.items()
        }
        self._values = {name: [] for name in means}
        return means
