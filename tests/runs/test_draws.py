"""Settings drawn by chance: what is drawn, and what a run keeps of it."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from tests.sweeps import make_exploration, make_run
from toponav.config import SettingsError
from toponav.launch import resumed_arguments
from toponav.reports import report_exploration
from toponav.runs import find_runs, keep_draws, log_uniform, swept_settings

LR = "loss.lr=${log_uniform:1e-4,5e-3}"


def draw(seed: int, low: float = 1e-4, high: float = 5e-3) -> float:
    return log_uniform(low, high, _root_=OmegaConf.create({"seed": seed}))


@pytest.fixture(autouse=True)
def resolver():
    OmegaConf.register_new_resolver("log_uniform", log_uniform, replace=True)


def test_a_draw_is_a_function_of_seed_and_bounds() -> None:
    # What earlier runs drew must not change.
    assert [draw(seed) for seed in (0, 1, 7)] == [0.001905, 0.003924, 0.0001107]
    assert draw(0, 5e-4, 1e-2) == 0.002403
    assert draw(3, 0.25, 0.25) == 0.25


def test_draws_are_log_uniform() -> None:
    found = np.array([draw(seed) for seed in range(2000)])
    assert found.min() >= 1e-4
    assert found.max() <= 5e-3
    level = np.log(found / 1e-4) / math.log(50)
    # Uniform on [0, 1]: a fifth in each fifth, 400 with a deviation of 18.
    counts, _ = np.histogram(level, 5, (0, 1))
    assert np.abs(counts - 400).max() < 4 * 18
    # The other bounds' draws are others.
    other = [math.log(draw(seed, 5e-4, 1e-2) / 5e-4) for seed in range(2000)]
    assert abs(np.corrcoef(level, other)[0, 1]) < 0.1


@pytest.mark.parametrize("bounds", [(0, 1), (2.0, 1.0), ("a", 1.0), (1.0, math.inf)])
def test_bounds_that_are_none_are_refused(bounds) -> None:
    with pytest.raises(SettingsError, match="log_uniform must have two bounds, above"):
        draw(0, *bounds)


@pytest.mark.parametrize("word", [LR, r"loss.lr=$\{log_uniform\:1e-4\,5e-3\}"])
def test_a_run_keeps_plain_numbers(tmp_path: Path, word: str) -> None:
    folder = make_run(tmp_path, "explore", "maze=maze1", word, seed=7)
    loss = {"lr": "${log_uniform:1e-4,5e-3}"}
    config = OmegaConf.create({"seed": 7, "loss": loss, "threads": "${seed}"})
    keep_draws(folder / "config", config, ["maze=maze1", word, "seed=7"])
    saved = yaml.safe_load((folder / "config/config.yaml").read_text())
    # What was not drawn stays as it was.
    assert saved == {"seed": 7, "loss": {"lr": 0.0001107}, "threads": "${seed}"}
    assert config.loss.lr == 0.0001107
    words = ["maze=maze1", "loss.lr=0.0001107", "seed=7"]
    assert yaml.safe_load((folder / "config/overrides.yaml").read_text()) == words
    assert resumed_arguments([f"resume={folder}"], "explore")[:3] == words
    (run,) = find_runs(tmp_path)
    assert run.drawn == {"loss.lr": 0.0001107}
    assert run.given == {"maze": "maze1"}


def test_without_a_draw_nothing_is_written(tmp_path: Path) -> None:
    keep_draws(tmp_path, OmegaConf.create({"seed": 1}), ["seed=1", "k=${seed}"])
    assert not list(tmp_path.iterdir())


def test_an_interpolation_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "explore", "pairs.k=3", "pairs.locomotion_k=${pairs.k}")
    (run,) = find_runs(tmp_path)
    assert run.given["pairs.locomotion_k"] == "${pairs.k}"
    found = resumed_arguments([f"resume={folder}"], "explore")
    assert found[1] == "pairs.locomotion_k=${pairs.k}"


def test_all_draws_are_one_group_with_its_five_best(tmp_path: Path) -> None:
    for maze in ("maze1", "maze2"):
        for seed in range(6):
            best = [0.5 + 0.05 * seed, 0.5]
            words = (f"maze={maze}", LR)
            folder = make_exploration(tmp_path, *words, seed=seed, best=best)
            (folder / "config/draws.yaml").write_text(f"loss.lr: {(seed + 1) / 1000}\n")
    runs = find_runs(tmp_path)
    assert swept_settings(runs) == ["maze"]
    scores = report_exploration(runs).scores
    one = next(one for one in scores if one.settings["maze"] == "maze2")
    assert one.values.shape == (6, 2)
    # Means 62.5, 60, 57.5 and so on.
    assert one.best_draws[0] == (pytest.approx(62.5), "loss.lr 0.006")
    assert [lr for _, lr in one.best_draws] == [
        f"loss.lr 0.00{number}" for number in (6, 5, 4, 3, 2)
    ]
