"""The schema of ``recipes/reproduce.py``: experiments as data."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from omegaconf import MISSING

from toponav.config.checks import (
    MOST_DRAWS,
    Settings,
    above,
    at_least,
    one_of,
    require,
    require_finite,
)


@dataclass
class RowConfig(Settings):
    """A method of a table: what it is called, and which settings make it."""

    label: str = MISSING
    overrides: list[str] = field(default_factory=list)
    #: More of them at one scale alone.
    laptop_overrides: list[str] = field(default_factory=list)
    paper_overrides: list[str] = field(default_factory=list)
    #: Settings of a run with the same seed that comes first, of the same recipe or, if
    #: that navigates, of an exploration; its folder is ``{first}`` in the overrides,
    #: and ``{maze}`` stands for the setting that names the maze.
    first: list[str] = field(default_factory=list)
    #: The same of another one, ``{policy}``, whose policy navigates; and more of its
    #: settings at one scale alone.
    policy: list[str] = field(default_factory=list)
    laptop_policy: list[str] = field(default_factory=list)
    paper_policy: list[str] = field(default_factory=list)
    #: The row whose runs with the same seeds these are compared with.
    against: str | None = None
    #: Mazes of this row alone; those of the experiment if there are none.
    mazes: list[str] = field(default_factory=list)
    #: Settings that are drawn by chance, in place of the experiment's.
    drawn: list[str] = field(default_factory=list)
    #: The row whose drawn settings this one takes, too.
    choice_of: str | None = None
    #: Whether its method has passed the sanity task of its own paper's kind; one that
    #: has not is made and shown only if ``rows`` names it.
    passed: bool = True


@dataclass
class PaperConfig(Settings):
    """The paper's own figures of a row in a maze, by the table's columns."""

    row: str = MISSING
    maze: str = MISSING
    values: dict[str, float] = field(default_factory=dict)


@dataclass
class ExperimentConfig(Settings):
    """A table of the paper (``conf/experiment``)."""

    group = "experiment"
    name: str = MISSING
    title: str = MISSING
    recipe: str = one_of("explore", "pretrain", "navigate")
    mazes: list[str] = MISSING
    overrides: list[str] = MISSING
    laptop_overrides: list[str] = field(default_factory=list)
    paper_overrides: list[str] = field(default_factory=list)
    rows: list[RowConfig] = MISSING
    scripted: list[str] = MISSING
    columns: list[str] = MISSING
    paper: list[PaperConfig] = MISSING
    remarks: list[str] = MISSING
    #: Settings that are drawn by chance for each row, some tries each, and the mazes in
    #: which they are tried: the best draw makes the row's runs. Of an experiment that
    #: navigates they are for the policy of a row, or for its first run without any.
    drawn: list[str] = field(default_factory=list)
    choose_on: list[str] = field(default_factory=list)
    #: More settings of the tries alone.
    choose_with: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        labels = [row.label for row in self.rows]
        rule = "experiment.rows must have a label each"
        require(len(set(labels)) == len(labels), rule, f"{', '.join(labels)}")
        for row in self.rows:
            known = row.against is None or row.against in labels
            rule = f"what row '{row.label}' is compared with must be a row"
            require(known, rule, f"'{row.against}'")
            known = row.choice_of is None or row.choice_of in labels
            rule = f"what row '{row.label}' takes its drawn settings from must be a row"
            require(known, rule, f"'{row.choice_of}'")
        draws = bool(self.drawn or any(row.drawn for row in self.rows))
        rule = "experiment.choose_on must name mazes if settings are drawn"
        require(bool(self.choose_on) or not draws, rule, "none")
        rule = "experiment.drawn must be empty unless its recipe is explore or navigate"
        require(self.recipe != "pretrain" or not draws, rule, f"{self.recipe}")

    def drawn_of(self, row: RowConfig) -> list[str]:
        """The settings that are drawn for a row; none if it takes another's."""
        return [] if row.choice_of else list(row.drawn or self.drawn)


@dataclass
class ReproduceConfig(Settings):
    """Settings of ``recipes/reproduce.py``."""

    experiment: ExperimentConfig = MISSING
    scale: str = one_of("smoke", "laptop", "paper")
    seeds: int = at_least(1)
    first_seed: int = at_least(0)
    tries: int = at_least(0)
    most_mazes: int | None = at_least(1)
    rows: list[str] = MISSING
    explore_overrides: list[str] = MISSING
    pretrain_overrides: list[str] = MISSING
    navigate_overrides: list[str] = MISSING
    #: By the name of the learner.
    explore_s: dict[str, float | None] = MISSING
    pretrain_s: float | None = above(0)
    navigate_s: float | None = above(0)
    runs: str = MISSING
    folder: str = MISSING
    jobs: int = at_least(1)
    worker: int = at_least(0)
    make: bool = MISSING
    poll_s: float = above(0)
    draws: int = at_least(1, most=MOST_DRAWS)

    def __post_init__(self) -> None:
        super().__post_init__()
        labels = [row.label for row in self.experiment.rows]
        for row in self.rows:
            rule = f"rows must name some of {', '.join(labels)}"
            require(row in labels, rule, f"'{row}'")
        for learner, seconds in self.explore_s.items():
            if seconds is not None:
                require_finite(name := f"explore_s.{learner}", seconds)
                require(seconds > 0, f"{name} must be above 0", seconds)
        require(bool(self.runs), "runs must name a folder", f"'{self.runs}'")
        require(bool(self.folder), "folder must name a folder", f"'{self.folder}'")

    def overrides_of(self, given: RowConfig | ExperimentConfig) -> list[str]:
        """The settings of a row, or of all rows, at this scale."""
        scaled = {"laptop": given.laptop_overrides, "paper": given.paper_overrides}
        return [*given.overrides, *scaled.get(self.scale, [])]

    def policy_of(self, row: RowConfig) -> list[str]:
        """The settings of the run whose policy a row plays, at this scale."""
        scaled = {"laptop": row.laptop_policy, "paper": row.paper_policy}
        return [*row.policy, *(scaled.get(self.scale, []) if row.policy else [])]

    def seconds_of(self, recipe: str, learner: str | None = None) -> float:
        """Seconds that a run of a recipe takes, by the settings; NaN if unknown.

        Those of an exploration depend on its learner.
        """
        if recipe == "explore":
            found = self.explore_s.get(learner or "")
        else:
            found = self.pretrain_s if recipe == "pretrain" else self.navigate_s
        return math.nan if found is None else found


def maze_words(given: str) -> tuple[str, list[str]]:
    """The name of a maze of an experiment, and the settings that choose it.

    What stands before a colon is the name, what stands after it the settings.

    Examples:
        >>> maze_words("maze1")
        ('maze1', ['maze=maze1'])
        >>> maze_words("generated 3: maze=random maze.seed=3")
        ('generated 3', ['maze=random', 'maze.seed=3'])
    """
    name, colon, words = given.partition(":")
    return name.strip(), words.split() if colon else [f"maze={given}"]


def paper_figures(
    paper: list[PaperConfig],
) -> Mapping[tuple[str, str], Mapping[str, float]]:
    """The paper's figures by row and maze."""
    return {(one.row, one.maze): one.values for one in paper}
