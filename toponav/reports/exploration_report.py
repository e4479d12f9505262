"""`ExplorationReport`: what a run shows while it explores."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from tqdm import tqdm

from toponav.builders import NETWORKS, POLICY, Consumer, World
from toponav.config import ExploreConfig
from toponav.metrics import correlation, trace_episode
from toponav.plotting import draw_exploration, draw_training, save_figure
from toponav.reports.baselines import Baselines
from toponav.reports.exploration_evaluation import make_plan
from toponav.reports.schedule import EXPLORE, Schedule
from toponav.runs import make_loggers, write_history
from toponav.training import EpisodeLog, ExplorationState, Row, mean_of

#: Episodes over which return and coverage are correlated.
_CORRELATED = 100
_START = {"decisions": 0, "seconds": 0.0}
#: Columns by other words in the progress bar.
_WORDS = {"intrinsic_return": "return"}
_WORDS |= {"loss_objective": "objective", "loss_critic": "critic"}


@dataclass
class ExplorationReport:
    """Collects measurements, writes rows and pictures, and keeps the progress bar.

    Rows are added to ``state``, and the consumers write their files too.
    """

    settings: ExploreConfig
    world: World
    folder: Path
    state: ExplorationState
    log: EpisodeLog
    consumers: Mapping[str, Consumer]
    schedule: Schedule
    baselines: Baselines

    def __post_init__(self) -> None:
        self.loggers = make_loggers(self.folder, self.state.decisions)
        self.bar = tqdm(
            desc="explore",
            total=self.settings.collect.decisions,
            initial=self.state.decisions,
            unit="decision",
            smoothing=0.05,
        )
        self._drawing = Timer(self.settings.report.pictures_every_s)
        self._done_before = self.state.progress
        self.schedule.begin(EXPLORE, rest=1 - self.state.progress)

    def update(self, measured: Mapping[str, float], decisions: int) -> None:
        """Count what was measured of a batch; write rows and pictures if it is time."""
        for name, value in measured.items():
            self.state.measured.setdefault(name, []).append(value)
        self.state.ended += self.log.ended
        self.bar.update(decisions)
        is_last = self.state.progress == 1
        last = self.state.history[-1] if self.state.history else _START
        since = self.state.decisions - last["decisions"]
        is_row = is_last or since >= self.settings.report.every
        if is_row:
            self._write_row(last)
        # The first pictures come with the first row.
        is_first = is_row and len(self.state.history) == 1
        if is_last or is_first or self._drawing.is_due():
            self._draw()

    def close(self) -> None:
        """Leave the progress bar as it is."""
        self.bar.close()

    def _write_row(self, last: Row) -> None:
        state, log = self.state, self.log
        seconds = max(state.seconds - last["seconds"], 1e-9)
        row: Row = {
            "decisions": state.decisions,
            "seconds": state.seconds,
            "decisions_per_second": (state.decisions - last["decisions"]) / seconds,
            "episodes": len(log.rows),
            **{name: mean_of(state.ended, name) for name in (*log.ends, *log.sums)},
            **_correlate(log.rows[-_CORRELATED:]),
            **{
                name: fmean(values) if values else math.nan
                for name, values in state.measured.items()
            },
            # Of the last batch, not a mean.
            "lr": (state.measured.get("lr") or [0.0])[-1],
            "policy_version": state.versions.get(POLICY, 0),
            "networks_version": state.versions.get(NETWORKS, 0),
        }
        state.ended = []
        # The names stay: every row has all columns.
        state.measured = {name: [] for name in state.measured}
        state.history.append(row)
        for logger in self.loggers:
            named = {f"explore/{name}": value for name, value in row.items()}
            logger.log_metrics(named, step=int(row["decisions"]))
        write_history(self.folder / "metrics.csv", state.history)
        if log.rows:
            write_history(self.folder / "episodes.csv", log.rows)
        self.bar.set_postfix_str(format_progress(row))
        done = self._done_before
        self.schedule.show((state.progress - done) / (1 - done))

    def _draw(self) -> None:
        tables, levels = (self.log.rows, self.state.history), self.baselines.levels()
        figure = draw_training(*tables, levels=levels, title=self.world.name)
        save_figure(figure, self.folder / "curves.png")
        shown, reward = self.log.shown_episode, self.log.sums["intrinsic_return"]
        if shown is not None and self.world.layout is not None:
            trace = trace_episode(shown, reward=reward)
            figure = draw_exploration(trace, make_plan(self.world))
            save_figure(figure, self.folder / "map.png")
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
        >>> row = {"coverage": math.nan, "running_coverage": 0.1}
        >>> row |= {"running_waypoints": 3.0}
        >>> format_progress(row | {"loss_objective": -0.004, "entropy": 1.75})
        'running coverage 10%, running waypoints 3, objective -0.004, entropy 1.75'
    """
    formats = {"coverage": ".0%", "waypoints": ".0f"}
    # Until the first episode ends, what those that run have seen.
    if all(math.isnan(row.get(name, math.nan)) for name in formats):
        formats = {f"running_{name}": form for name, form in formats.items()}
    formats |= {"intrinsic_return": ".0f", "loss_objective": ".3f"}
    formats |= {"loss_critic": ".3f", "entropy": ".2f"}
    return ", ".join(
        f"{_WORDS.get(name, name.replace('_', ' '))} {row[name]:{form}}"
        for name, form in formats.items()
        if not math.isnan(row.get(name, math.nan))
    )


class Timer:
    """True once every ``seconds`` seconds.

    Examples:
        >>> Timer(1e-9).is_due(), Timer(60).is_due()
        (True, False)
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._last: float | None = time.monotonic()

    def is_due(self) -> bool:
        """Whether it is; the next time is counted from when what was due is done."""
        now = time.monotonic()
        # The question after one that was answered yes comes when that is done.
        self._last = now if self._last is None else self._last
        if now - self._last < self.seconds:
            return False
        self._last = None
        return True
