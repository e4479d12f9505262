"""`ExplorationState`: what a run of exploration has done so far."""

from dataclasses import dataclass, field

from toponav.config import ExploreCollectConfig
from toponav.training.episode_log import Row, mean_of

#: Policies that see nothing: blind baselines.
BASELINES = ("random", "sticky")


@dataclass
class ExplorationState:
    """Counters and tables of a run."""

    decisions: int = 0  # learned from, over all environments
    seconds: float = 0.0  # of exploring; pre-training is not in it
    progress: float = 0.0  # how much of the run is over, in [0, 1]
    versions: dict[str, int] = field(default_factory=dict)  # newest published, by name
    history: list[Row] = field(default_factory=list)  # rows of metrics.csv
    evaluations: list[Row] = field(default_factory=list)  # rows of evaluation.csv

    def count(
        self, decisions: int, seconds: float, collect: ExploreCollectConfig
    ) -> None:
        """Count a batch's decisions; ``seconds`` are the run's so far.

        ``collect`` says when a run is over, by decisions or by the clock.
        """
        self.decisions += decisions
        self.seconds = seconds
        by_clock = seconds / (60 * collect.minutes) if collect.minutes else 0.0
        self.progress = min(1.0, max(self.decisions / collect.decisions, by_clock))

    @property
    def baselines(self) -> dict[str, float]:
        """Mean coverage of the blind baselines, by name; empty where it is unknown."""
        rows = [row for row in self.evaluations if row["policy"] in BASELINES]
        names = dict.fromkeys(str(row["policy"]) for row in rows if "coverage" in row)
        return {
            name: mean_of([row for row in rows if row["policy"] == name], "coverage")
            for name in names
        }
