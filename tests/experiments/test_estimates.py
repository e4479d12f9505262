"""How long runs take: by their learner, and what nobody has measured is said."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf

from tests.experiments.planning import reproducing
from tests.experiments.test_found_runs import save
from tests.sweeps import make_exploration, write_table
from toponav.config import ReproduceConfig, SettingsError
from toponav.experiments import Cell, announce, expected_seconds
from toponav.refusals import unknown_setting


@dataclass
class Maker:
    """Makes cells that only say what they are."""

    folder: Path
    made: list[Cell] = field(default_factory=list)

    def add(self, recipe: str, loss: str = "ppo", row: str = "some") -> Cell:
        key = f"{len(self.made)}"
        words = {"loss": {"name": loss}, "reward": {"name": "random"}}
        config = OmegaConf.create({**words, "pretrained": None})
        at = self.folder / key
        self.made.append(Cell(row, "maze1", 0, recipe, (), config, key, at))
        return self.made[-1]

    def finish(self, cell: Cell, seconds: float) -> None:
        made = make_exploration(cell.folder / "made", best=[0.5])
        save(cell.folder, {"collect": {"decisions": 9, "minutes": None}})
        for table in made.glob("*.csv"):
            table.rename(cell.folder / table.name)
        rows: list[dict[str, object]] = [{"decisions": 9, "seconds": seconds}]
        write_table(cell.folder / "metrics.csv", rows)


@pytest.fixture
def maker(tmp_path: Path) -> Maker:
    return Maker(tmp_path)


@pytest.fixture(scope="module")
def laptop() -> ReproduceConfig:
    with reproducing("experiment=table8") as found:
        return found


def test_what_nobody_has_measured_is_named_and_not_in_the_time(
    laptop: ReproduceConfig, maker: Maker
) -> None:
    for recipe, loss in (
        *(("explore", "ppo"), ("explore", "dqn"), ("explore", "dqn")),
        *(("explore", "trpo"), ("navigate", ""), ("navigate", "")),
    ):
        maker.add(recipe, loss)
    # 436 s of PPO and 2 * 233 s of navigations: 902 s, 15.0 minutes.
    assert announce(laptop, maker.made) == (
        "table8: 6 of 6 runs are missing; about 15.0 minutes for 3 of them, one at a "
        "time (an estimate from figures in conf/reproduce); not measured: "
        "explorations with loss=dqn (2), explorations with loss=trpo (1)"
    )


def test_a_time_that_was_measured_here_is_that_of_the_same_learner(
    laptop: ReproduceConfig, maker: Maker
) -> None:
    slow, fast = maker.add("explore", "dqn", "DQN"), maker.add("explore", "ppo")
    maker.finish(slow, 900.0)
    maker.finish(fast, 30.0)
    # Its row has none: that of its learner.
    again = maker.add("explore", "dqn", "DQN (policy)")
    # Of its learner and its row.
    other = maker.add("explore", "ppo")
    unknown = maker.add("explore", "a3c", "A3C")
    expected, count, by_figure = expected_seconds(laptop, maker.made)
    assert count == 2
    assert expected[again.key] == 900
    assert expected[other.key] == 30
    assert str(expected[unknown.key]) == "nan"
    assert not by_figure
    # 900 + 30 s: 15.5 minutes.
    assert announce(laptop, maker.made) == (
        "table8: 3 of 5 runs are missing; about 15.5 minutes for 2 of them, one at a "
        "time (an estimate from 2 runs of this experiment); not measured: "
        "explorations with loss=a3c (1)"
    )


def test_runs_that_come_first_are_measured_too(
    laptop: ReproduceConfig, maker: Maker
) -> None:
    first = maker.add("explore", "drqn", "DRQN (policy)")
    maker.finish(first, 600.0)
    last = maker.add("navigate")
    cells = [Cell(**(vars(last) | {"policy": first})), maker.add("explore", "drqn")]
    expected, _, by_figure = expected_seconds(laptop, cells)
    assert expected == {last.key: 233, cells[1].key: 600}
    assert by_figure


def test_a_learner_that_is_none_is_refused() -> None:
    with reproducing("explore_s.dqn=900") as settings:
        assert settings.seconds_of("explore", "dqn") == 900
        assert unknown_setting("explore_s.dqn", "reproduce", {}) == ""
        assert "did you mean" in unknown_setting("explore_t.dqn", "reproduce", {})
    with pytest.raises(ConfigCompositionException), reproducing("explore_s.dqm=900"):
        pass


def test_a_time_that_is_none_is_refused() -> None:
    rule = r"explore_s.ppo must be above 0, got 0.0"
    with pytest.raises(SettingsError, match=rule), reproducing("explore_s.ppo=0"):
        pass


def test_a_row_that_explores_and_navigates_has_a_time_of_each(
    laptop: ReproduceConfig, maker: Maker
) -> None:
    tried = maker.add("explore", "dqn", "DQN")
    maker.finish(tried, 900.0)
    walk = maker.add("navigate", "", "DQN")
    expected, _, _ = expected_seconds(laptop, maker.made)
    # That of conf/reproduce, and not the 900 s of the exploration.
    assert expected[walk.key] == 233
