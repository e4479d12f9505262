"""Runs are found again by their settings, wherever they are and whoever made them."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.sweeps import make_exploration, make_pretraining, write_table
from toponav.experiments.found_runs import (
    find_keys,
    find_mapped,
    is_finished,
    named_run,
    run_key,
    seconds_of,
)

#: What an exploration without a map has, too.
OFF = {"locomotion": {"learn": False}}
SETTINGS = {"seed": 1, "threads": 1, "loss": {"lr": 0.1}, "pretrained": None}


def save(folder: Path, settings: dict[str, object], recipe: str = "explore") -> Path:
    (folder / "config").mkdir(parents=True, exist_ok=True)
    OmegaConf.save(OmegaConf.create(settings), folder / "config/config.yaml")
    hydra = {"hydra": {"job": {"config_name": recipe}}}
    OmegaConf.save(OmegaConf.create(hydra), folder / "config/hydra.yaml")
    return folder


def test_only_what_changes_a_result_changes_the_key() -> None:
    key = run_key("explore", SETTINGS)
    same = {"threads": 8, "device": "cuda", "resume": "a", "new": None}
    assert run_key("explore", SETTINGS | same) == key
    for other in ({"seed": 2}, {"loss": {"lr": 0.2}}, {"pretrained": "package:maze1"}):
        assert run_key("explore", SETTINGS | other) != key
    assert run_key("pretrain", SETTINGS) != key


def test_a_setting_that_was_a_number_in_code_leaves_the_keys_of_former_runs() -> None:
    def key(**locomotion: float) -> str:
        return run_key("explore", {**SETTINGS, "locomotion": locomotion})

    assert key(k=8, weight_decay=1e-3) == key(k=8) != key(k=8, weight_decay=1e-4)


def test_words_for_another_recipe_count_if_they_change_its_result() -> None:
    def key(*words: str) -> str:
        return run_key("explore", {**SETTINGS, "pretraining": {"overrides": [*words]}})

    assert key("train.threads=1", "+device=cuda") == key()
    updates = key("train.updates=5", "train.threads=2")
    assert updates == key("train.updates=5") != key()


def test_a_run_is_found_at_any_depth(tmp_path: Path) -> None:
    folder = save(tmp_path / "by/hand/run-1", {**SETTINGS, "maze": {"name": "maze1"}})
    save(tmp_path / "others", SETTINGS, recipe="tour")
    (save(tmp_path / "broken", SETTINGS) / "config/config.yaml").write_text("a: [")
    key = run_key("explore", {**SETTINGS, "maze": {"name": "maze1"}})
    assert find_keys(tmp_path) == {key: folder}
    assert find_keys(tmp_path / "nowhere") == {}


def test_another_run_counts_by_its_settings_and_not_by_its_folder(
    tmp_path: Path,
) -> None:
    key = run_key("pretrain", SETTINGS)
    keys = set()
    for name in ("here", "there"):
        folder = save(tmp_path / name, SETTINGS, recipe="pretrain")
        keys.add(run_key("explore", {"pretrained": str(folder)}))
        (folder / "networks.pt").touch()
        keys.add(run_key("explore", {"pretrained": str(folder / "networks.pt")}))
    # Nor need it be there yet.
    keys.add(run_key("explore", {"pretrained": named_run(key)}))
    assert len(keys) == 1


def test_a_finished_run_comes_before_one_that_was_cut_off(tmp_path: Path) -> None:
    save(tmp_path / "a", {"seed": 0})
    done = save(tmp_path / "b", {"seed": 0})
    for name in ("report.json", "metrics.csv"):
        made = make_pretraining(tmp_path / name, mazes={"maze1": 0.9})
        (done / name).write_text((made / name).read_text())
    assert not is_finished(done)
    (done / "networks.pt").touch()
    assert is_finished(done)
    assert find_keys(tmp_path)[run_key("explore", {"seed": 0})] == done
    # A damaged number of its settings says nothing of what it was to learn from.
    for damaged in ({"train": {"updates": "8x"}}, {"collect": {"decisions": "8x"}}):
        save(tmp_path / "b", damaged)
        assert not is_finished(done)


def test_one_that_was_cut_off_hides_no_finished_one_with_a_map(tmp_path: Path) -> None:
    collect = {"decisions": 400}
    done = make_exploration(tmp_path / "a", best=[0.9])
    write_table(done / "metrics.csv", [{"decisions": 400}])
    for folder in (done, tmp_path / "b"):
        save(folder, {"collect": collect, "map": {"grow": True}})
    key = run_key("explore", {"collect": collect, "map": {"grow": False}} | OFF)
    assert find_mapped(tmp_path) == {key: done}


@pytest.mark.parametrize(
    ("minutes", "finished"), [(None, False), (5.0, True), (5.1, False)]
)
def test_one_that_goes_on_is_not_finished(
    tmp_path: Path, minutes: float | None, finished: bool
) -> None:
    folder = make_exploration(tmp_path, best=[0.9])
    collect = {"decisions": 800, "minutes": minutes}
    save(folder, {"collect": collect})
    # Its last batch ended at 300.0004 s.
    write_table(folder / "metrics.csv", [{"decisions": 400, "seconds": 300}])
    assert is_finished(folder) == finished
    save(folder, {"collect": collect | {"decisions": 400}})
    assert is_finished(folder)


@pytest.mark.parametrize(("updates", "finished"), [(2, True), (3, False)])
def test_a_pre_training_that_goes_on_is_not_finished(
    tmp_path: Path, updates: int, finished: bool
) -> None:
    folder = make_pretraining(tmp_path, mazes={"maze1": 0.9})
    (folder / "networks.pt").touch()
    save(folder, {"train": {"updates": updates}}, recipe="pretrain")
    assert is_finished(folder) == finished
    assert is_finished(folder, networks=False) == finished


def test_a_navigation_is_known_by_the_runs_that_it_plays(tmp_path: Path) -> None:
    policy = save(tmp_path / "policy", SETTINGS)
    settings = {"run": "run a", "navigator": {"policy": str(policy)}}
    key = run_key("navigate", settings)
    named = named_run(run_key("explore", SETTINGS))
    assert run_key("navigate", {"run": "run a", "navigator": {"policy": named}}) == key
    folder = save(tmp_path / "played", settings, recipe="navigate")
    assert find_keys(tmp_path)[key] == folder
    assert not is_finished(folder)
    (folder / "summary.csv").touch()
    assert not is_finished(folder)
    row = {"policy": "navigator", "episode": 0, "goals": 1, "reward": 10.0}
    write_table(folder / "episodes.csv", [row | {"first_goal": 5, "spl": 0.5}])
    assert is_finished(folder)


def test_seconds_leave_out_the_pre_training(tmp_path: Path) -> None:
    rows = [("pre-train", 100.0), ("explore", 30.0), ("evaluate", 2.5)]
    table = [{"phase": phase, "seconds": took} for phase, took in rows]
    write_table(tmp_path / "phases.csv", table)
    assert seconds_of(tmp_path) == pytest.approx(32.5)
    assert str(seconds_of(tmp_path / "nowhere")) == "nan"
