"""`Schedule`: what a run does now, what comes after it, and when all will be done."""

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from toponav.builders import NETWORKS_FILE, pretraining_folder
from toponav.config import ExploreConfig
from toponav.methods import REWARDS
from toponav.runs import read_table, write_history

#: The phases of an exploration.
PRETRAIN, EXPLORE = "pre-train", "explore"
EVALUATE = "evaluate and finish map and networks"

#: Seconds on two cores of an AMD EPYC 9005, by ``results/main_job.json``: of the
#: laptop scale's pre-training, a decision of exploring, an update of the L-network's
#: head, a decision of the evaluation, and a decision of exploring in a map by poses.
#: Other machines take longer by about one factor.
_PRETRAIN_S, _EXPLORE_S, _HEAD_S, _EVALUATE_S = 375.0, 0.72e-3, 19e-3, 1.0e-3
_POSES_S = 0.18e-3
#: The share of a pre-training's time that is over when its first update begins, shortly
#: after its first picture (32 s on average).
_COLLECTED = 0.12
#: Seconds from one line to the next.
_AGAIN_S = 60.0
#: Seconds of progress that say how long the rest takes, and the share of a phase below
#: which nothing else does: it may begin with engines that start or a map that is made.
_RATE_S, _EARLY = 30.0, 0.05
#: Tells a pre-training the phases of the run that waits for it.
_WAITING = "TOPONAV_SCHEDULE"


class Schedule:
    """Announces the phases of a run, and says every minute how long the rest takes.

    Args:
        expected: seconds of each phase, in order, on the machine of the reference; NaN
            where nobody knows. A machine on which the phases so far took twice as long
            will need twice as long for the others.
        folder: gets ``phases.csv``: when each phase ended, in seconds since this was
            made, and how many seconds it took; once a minute so far of the one that
            runs.
        announce: whether each phase is announced when it begins.
        resumed: whether the times go on from those that earlier starts left there.

    Examples:
        >>> schedule = Schedule({"explore": 60.0, "evaluate": 30.0})
        >>> schedule.describe("explore")
        'phase 1 of 2: explore, then evaluate; all done in about 1.5 minutes'
        >>> schedule.describe("evaluate")
        'phase 2 of 2: evaluate; all done in about 0.5 minutes'
    """

    def __init__(
        self,
        expected: Mapping[str, float],
        folder: Path | None = None,
        *,
        announce: bool = True,
        resumed: bool = False,
    ) -> None:
        self.expected, self.folder, self.announce = dict(expected), folder, announce
        # By phase; and seconds of the one that runs in earlier starts, and of all.
        self._rows: dict[str, dict[str, Any]] = {}
        self._earlier = self._ended = 0.0
        if resumed and folder is not None:
            self._read(folder)
        self._made = self._began = self._said = time.monotonic()
        self._phase = ""
        # When the phase first showed progress, and its share then.
        self._first: tuple[float, float] | None = None
        # Seconds that the finished phases took, and were expected to take.
        self._took = self._should = 0.0
        # Shares of the parts of the phase that runs, which go on beside each other.
        self._parts: list[float] = []
        self._shows = threading.Lock()  # each part may show its own in a thread

    @property
    def minutes(self) -> float:
        """Minutes since this was made."""
        return (time.monotonic() - self._made) / 60

    def begin(self, phase: str, *, rest: float = 1.0) -> None:
        """Announce a phase, unless this run has none of the name.

        The one before is over. ``rest`` is the share that an earlier run left to do.
        """
        if phase not in self.expected:
            return
        self.end()
        self.expected[phase] *= rest
        self._phase, self._began = phase, time.monotonic()
        self._earlier = self._rows.get(phase, {}).get("seconds", 0.0)
        self._said, self._first = self._began, None
        self._parts.clear()
        if self.announce:
            self._say()

    def end(self) -> None:
        """The phase that runs is over, if one does."""
        if not self._phase:
            return
        took, should = time.monotonic() - self._began, self.expected[self._phase]
        if not math.isnan(should):
            self._took += took
            self._should += should
        self._write()
        self._phase = ""

    def _read(self, folder: Path) -> None:
        """Take over the rows of an earlier start; without whole ones all begins now."""
        with suppress(ValueError):
            columns = ("phase", "ended", "seconds")
            table = read_table(folder / "phases.csv", columns)
            rows = table[list(columns)].to_dict("records")
            self._rows = {row["phase"]: row for row in rows}
            self._ended = max(row["ended"] for row in rows)

    def _write(self) -> None:
        """Write the times of the phases so far, the one that runs included."""
        if self.folder is None:
            return
        now = time.monotonic()
        ended, took = self._ended + now - self._made, self._earlier + now - self._began
        row = {"phase": self._phase, "ended": round(ended, 1)}
        self._rows[self._phase] = row | {"seconds": round(took, 1)}
        write_history(self.folder / "phases.csv", list(self._rows.values()))

    def describe(self, phase: str, share: float = 0.0) -> str:
        """The line of a phase of which a ``share`` in [0, 1] is done.

        When all will be done is counted on the phases before it, and on this one once
        some of it is done.
        """
        later, expected = self._later(phase), self.expected[phase]
        names, so_far, should = list(self.expected), self._took, self._should
        text = f"phase {names.index(phase) + 1} of {len(names)}: {phase}"
        if later:
            text += f", then {', '.join(later)}"
        factor = so_far / should if should else 1.0
        rest = self._rest(share, factor * expected)
        if share and not math.isnan(expected):
            # As much of the phase as its share, startup counted once.
            whole = time.monotonic() - self._began + rest
            factor = (so_far + share * whole) / (should + share * expected)
        known = factor * sum(later.values())
        if math.isnan(rest):
            return f"{text}; all done about {_minutes(known)} after that"
        return f"{text}; all done in about {_minutes(known + rest)}"

    def _rest(self, share: float, usual: float) -> float:
        """Seconds that the rest of the phase takes, all of which takes ``usual``."""
        if not self._parts:
            return self._measured(share) if share else usual
        # Parts that end leave their cores to others, so that no rate is steady: the
        # less is done, the more counts what is usual.
        due = max(usual - (time.monotonic() - self._began), 0.0)
        return share * self._measured(share) + (1 - share) * due if share else due

    def _measured(self, share: float) -> float:
        """Seconds that the rest of the phase takes at the rate of its progress."""
        now = time.monotonic()
        if self._first is not None:
            since, before = self._first
            if now - since >= _RATE_S and share > before:
                return (now - since) * (1 - share) / (share - before)
        return (now - self._began) * (1 / share - 1)

    def show(self, share: float) -> None:
        """Announce the phase that runs once more, of which a ``share`` is done.

        No oftener than once a minute, and not before its progress says how long it will
        take.
        """
        now = time.monotonic()
        if not self._phase:
            return
        if self._first is None:
            self._first = now, share
        known = share >= _EARLY or now - self._first[0] >= _RATE_S
        if known and now - self._said >= _AGAIN_S:
            self._say(share)
            # For the next start, if this one is cut off; no reason to end it.
            with suppress(OSError):
                self._write()

    def part(self) -> Callable[[float], None]:
        """What shows the share of one of several parts of the phase that runs.

        They go on beside each other, and the one that is least far decides.
        """
        number = len(self._parts)
        self._parts.append(0.0)

        def show(share: float) -> None:
            with self._shows:
                self._parts[number] = share
                self.show(min(self._parts))

        return show

    def _say(self, share: float = 0.0) -> None:
        self._said = time.monotonic()
        # Beside the bars; standard output has the results.
        tqdm.write(self.describe(self._phase, share), file=sys.stderr)

    def environment(self) -> dict[str, str]:
        """Environment variables that tell a pre-training what comes after it."""
        return {_WAITING: json.dumps(self.expected)}

    def _later(self, phase: str) -> dict[str, float]:
        names = list(self.expected)
        return {name: self.expected[name] for name in names[names.index(phase) + 1 :]}


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.1f} minutes"


def explore_schedule(settings: ExploreConfig, folder: Path) -> Schedule:
    """The phases of an exploration with these settings, and what they should take.

    The run's ``folder`` gets ``phases.csv``: seconds of each phase.
    """
    expected: dict[str, float] = {}
    needed = REWARDS[settings.reward.name].needs_networks
    given = settings.pretrained or settings.resume
    if needed and not given:
        found = (pretraining_folder(settings) / NETWORKS_FILE).is_file()
        pretraining = settings.pretraining
        usual = pretraining.scale == "laptop" and not pretraining.overrides
        usual = usual and settings.model.encoder == "small"
        if not found:
            expected[PRETRAIN] = _PRETRAIN_S if usual else math.nan
    collect = settings.collect
    expected[EXPLORE] = collect.decisions * _EXPLORE_S
    if collect.minutes:
        expected[EXPLORE] = min(expected[EXPLORE], 60 * collect.minutes)
    has_networks = needed or settings.pretrained is not None
    decisions = 2 * settings.evaluate.episodes * settings.world.episode_length
    expected[EVALUATE] = decisions * _EVALUATE_S
    by_poses = settings.maps_by_poses(effects_known=settings.world.group == "maze")
    if by_poses:
        expected[EVALUATE] += collect.decisions * _POSES_S
    # Beside the evaluation, a core each.
    if has_networks and settings.trains_head(by_poses=by_poses):
        tuning = settings.locomotion.updates * _HEAD_S
        expected[EVALUATE] = max(tuning, expected[EVALUATE])
    return Schedule(expected, folder, resumed=settings.resume is not None)


def pretrain_schedule() -> Schedule:
    """The phase of a pre-training, and those of the run that waits for it, if one does.

    That run has announced it.
    """
    waiting = os.environ.get(_WAITING)
    expected = json.loads(waiting) if waiting else {PRETRAIN: math.nan}
    return Schedule(expected, announce=False)


def is_waited_for() -> bool:
    """Whether this process pre-trains for an exploration, which started it."""
    return _WAITING in os.environ


def pretrained_share(done: float) -> float:
    """The share of a pre-training's time that is over after a share of its updates.

    Examples:
        >>> pretrained_share(0.5)
        0.56
    """
    return _COLLECTED + (1 - _COLLECTED) * done
