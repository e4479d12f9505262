"""The tables of finished runs outlive the runs, and a table is made of them again."""

import math
import shutil
from dataclasses import replace
from pathlib import Path
from threading import Thread

import pytest
from omegaconf import OmegaConf

from tests.experiments.planning import reproducing
from tests.experiments.test_choosing import finish, small
from tests.experiments.test_found_runs import save
from tests.sweeps import make_pretraining
from toponav.builders import pretraining_folder
from toponav.config import ReproduceConfig, RowConfig
from toponav.experiments import (
    Cell,
    announce,
    keep_runs,
    make_groups,
    missing_cells,
    missing_sentences,
    plan_cells,
)
from toponav.experiments.decisions_before import decisions_before, explore_settings
from toponav.experiments.found_runs import find_keys, is_finished
from toponav.reports import explore_table
from toponav.runs import locked

TABLES = {"evaluation.csv", "episodes.csv", "metrics.csv"}


@pytest.fixture
def settings(tmp_path: Path):
    """Three rows of one run each; the table is in the folder of the runs."""
    words = ["reproduce=smoke", f"runs={tmp_path}", f"folder={tmp_path / 'table'}"]
    with reproducing(*words, "most_mazes=1") as given:
        yield small(given)


def lose(cells: list[Cell]) -> None:
    for cell in cells:
        shutil.rmtree(cell.folder, ignore_errors=True)


def test_a_table_is_made_again_of_what_is_kept(settings: ReproduceConfig) -> None:
    cells = plan_cells(settings)
    for number, cell in enumerate(cells):
        finish(cell, 0.5 + 0.1 * number)
        (cell.folder / "policy.pt").touch()
        (cell.folder / "map.png").touch()
    table = explore_table(make_groups(settings, cells), {}, draws=50)
    keep_runs(cells)
    for cell in cells:
        found = {path.name for path in cell.kept.rglob("*") if path.is_file()}
        assert found == TABLES | {"config.yaml"}
    lose(cells)

    again = plan_cells(settings)
    assert [cell.results for cell in again] == [
        Path(settings.folder) / "runs" / cell.key for cell in cells
    ]
    assert missing_cells(again) == missing_sentences(again, {}) == []
    assert announce(settings, again) == "table3: all 3 runs are there"
    made = explore_table(make_groups(settings, again), {}, draws=50)
    assert made.equals(table)
    # What is kept is nobody's run: others would look for its networks.
    assert find_keys(Path(settings.runs)) == {}


def test_what_networks_learned_from_is_kept_with_the_run(
    settings: ReproduceConfig, tmp_path: Path
) -> None:
    own = f"pretraining.folder={tmp_path}/pretrain"
    row = RowConfig(label="novelty", overrides=["reward=novelty", own])
    settings = replace(settings, experiment=replace(settings.experiment, rows=[row]))
    (cell,) = plan_cells(settings)
    finish(cell, 0.5)
    pretrained = pretraining_folder(explore_settings(cell))
    # Where the pre-training is not there any more, nobody knows.
    keep_runs([cell])
    assert math.isnan(decisions_before(cell))
    (pretrained / "config").mkdir(parents=True)
    (pretrained / "config" / "config.yaml").write_text("collect: {decisions: 98304}\n")
    table = explore_table(make_groups(settings, [cell]), {}, draws=50)
    assert decisions_before(cell) == 98304
    # A copy of an earlier version learns of it, and a new one has it.
    keep_runs([cell])
    lose([cell, replace(cell, folder=pretrained)])
    assert decisions_before(cell) == 98304
    assert explore_table(make_groups(settings, [cell]), {}, draws=50).equals(table)
    finish(cell, 0.5)
    shutil.rmtree(cell.kept)
    assert math.isnan(decisions_before(cell))
    (pretrained / "config").mkdir(parents=True)
    (pretrained / "config" / "config.yaml").write_text("collect: {decisions: 4096}\n")
    keep_runs([cell])
    lose([cell, replace(cell, folder=pretrained)])
    assert decisions_before(cell) == 4096
    # A damaged one is as good as none.
    for text in (
        "[" * 100_000,
        "",
        "[]",
        '{"decisions": null}',
        "{}",
        f'{{"decisions": 1{400 * "0"}}}',
    ):
        (cell.kept / "decisions_before.json").write_text(text)
        assert math.isnan(decisions_before(cell))


def test_where_a_run_was_resumed_is_not_kept(settings: ReproduceConfig) -> None:
    plain, resumed, _ = cells = plan_cells(settings)
    for cell in cells:
        finish(cell, 0.5)
    before = OmegaConf.load(resumed.folder / "config/config.yaml")
    changed = OmegaConf.merge(before, {"resume": "runs/7"})
    OmegaConf.save(changed, resumed.folder / "config/config.yaml")
    words = ["maze=maze3", "reward.alpha=${loss.lr}", "resume='runs/7'"]
    OmegaConf.save(OmegaConf.create(words), resumed.folder / "config/overrides.yaml")
    keep_runs(cells)
    saved = resumed.kept / "config"
    assert OmegaConf.load(saved / "config.yaml") == before
    assert (
        saved / "overrides.yaml"
    ).read_text() == "- maze=maze3\n- reward.alpha=${loss.lr}\n"
    names = "config/config.yaml"
    assert (plain.kept / names).read_bytes() == (plain.folder / names).read_bytes()
    assert resumed.results == resumed.kept


def test_half_a_copy_is_not_read(
    settings: ReproduceConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = plan_cells(settings)[0]
    finish(cell, 0.5)
    copyfile = shutil.copyfile

    def fail(source: Path, target: Path) -> None:
        if source.name == "metrics.csv":
            raise OSError("no room")
        copyfile(source, target)

    with monkeypatch.context() as broken:
        broken.setattr(shutil, "copyfile", fail)
        with pytest.raises(OSError, match="no room"):
            keep_runs([cell])
    assert not cell.kept.exists()
    assert cell.results == cell.folder
    keep_runs([cell])
    assert cell.results == cell.kept
    # One that was damaged later is made again, as long as its run is there.
    (cell.kept / "episodes.csv").write_text("decisions,coverage\n1800\n")
    assert cell.results == cell.folder
    keep_runs([cell])
    assert cell.results == cell.kept
    (cell.kept / "episodes.csv").unlink()
    lose([cell])
    assert cell.results is None
    assert missing_cells([cell]) == [cell]


def test_half_a_copy_of_a_process_that_was_killed_is_removed(
    settings: ReproduceConfig,
) -> None:
    cell, other, _ = plan_cells(settings)
    finish(cell, 0.5)
    assert cell.kept is not None
    half = cell.kept.with_name(f".{cell.kept.name}.ab_d3f9h")
    # Once as it is kept, and once when it is kept already.
    for _ in range(2):
        (half / cell.kept.name).mkdir(parents=True)
        keep_runs([cell])
        assert [path.name for path in cell.kept.parent.iterdir()] == [cell.kept.name]
    # A living process holds its lock.
    half.mkdir()
    lock = cell.kept.with_name(f".{cell.kept.name}.lock")
    with locked(lock):
        waiting = Thread(target=keep_runs, args=([cell],))
        waiting.start()
        keep_runs([other])  # which nothing keeps waiting
        waiting.join(0.2)
        assert half.exists()
    waiting.join()
    assert not half.exists()


def test_what_is_kept_stays_as_it_is(settings: ReproduceConfig) -> None:
    cell = plan_cells(settings)[0]
    finish(cell, 0.5)
    keep_runs([cell])
    before = {path: path.stat().st_ino for path in cell.kept.rglob("*")}
    text = (cell.folder / "evaluation.csv").read_text()
    (cell.folder / "evaluation.csv").write_text(text.replace("0.4", "0.6"))
    keep_runs([cell])
    assert {path: path.stat().st_ino for path in cell.kept.rglob("*")} == before
    assert (cell.kept / "evaluation.csv").read_text() == text


def test_a_run_is_made_again_if_another_one_starts_from_it(
    settings: ReproduceConfig,
) -> None:
    row = RowConfig(
        label="tuned",
        overrides=["reward=random", "init_policy={first}"],
        first=["maze=select", "reward=random"],
    )
    experiment = replace(settings.experiment, rows=[row])
    settings = replace(settings, experiment=experiment, seeds=2)
    cells = plan_cells(settings)
    firsts = [cell.first for cell in cells if cell.first is not None]
    for cell in (*firsts, cells[0]):
        finish(cell, 0.5)
    keep_runs([*firsts, cells[0]])
    assert missing_cells(cells) == [cells[1]]
    lose([*firsts, *cells])
    # The first seed is kept, and nothing starts from its first run any more.
    assert missing_cells(cells) == [firsts[1], cells[1]]


def test_a_pre_training_is_kept_without_its_networks(tmp_path: Path) -> None:
    folder = save(make_pretraining(tmp_path, mazes={"maze1": 0.9}), {"seed": 0})
    (folder / "networks.pt").touch()
    kept = tmp_path / "kept"
    cell = Cell("k = 1", "", 0, "pretrain", (), {}, "key", folder, kept=kept)
    keep_runs([cell])
    assert {path.name for path in kept.iterdir()} == {
        *("config", "report.json", "metrics.csv")
    }
    lose([cell])
    assert cell.results == kept
    assert not is_finished(kept)
