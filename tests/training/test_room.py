"""What a run needs of the machine, looked at before it starts anything."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.composed import settings
from tests.exploring import explore_settings, make_policy, world_of
from tests.forked import run_forked
from tests.mounts import disk, needs_mounts
from tests.sweeps import make_exploration
from toponav.builders import make_networks, pretraining_folder, save_networks
from toponav.config import ExploreConfig, PretrainConfig, SettingsError
from toponav.methods import make_worlds
from toponav.training import require_explore_room, require_pretrain_room, room

Needs = dict[str, float]


@pytest.fixture
def needs(monkeypatch: pytest.MonkeyPatch) -> Needs:
    """Megabytes that are asked for, by setting."""
    found: Needs = {}
    monkeypatch.setattr(
        room, "require_room", lambda _, setting, size: found.update({setting: size})
    )
    monkeypatch.setattr(
        room, "require_shared_memory", lambda size, name: found.update({name: size})
    )
    return found


def ask(config: ExploreConfig, folder: Path) -> None:
    require_explore_room(config, world_of(config), folder)


def test_what_an_exploration_needs_is_less_than_it_took(
    needs: Needs, tmp_path: Path
) -> None:
    """117.8 MB of shared memory were seen in use by the default run, 6.7 in smoke."""
    found = settings(
        "explore", "pretrained=package:maze3", f"evaluate.random_folder={tmp_path}"
    )
    assert isinstance(found, ExploreConfig)
    ask(found, tmp_path)
    assert 0.9 * 117.8 < needs["collect.envs"] < 117.8
    ask(explore_settings("scale=smoke", "reward=random", "policy.hidden=32"), tmp_path)
    assert 0.9 * 6.67 < needs["collect.envs"] < 6.67


def test_the_networks_that_processes_fetch_count(needs: Needs, tmp_path: Path) -> None:
    given = ("reward=rnd", "policy.input=pixels", "map.grow=false")
    ask(explore_settings(*given), tmp_path)
    without = needs["collect.envs"]
    config = explore_settings(*given, f"pretrained={tmp_path}")
    ask(config, tmp_path)
    tc = make_networks(config.model, world_of(config).spec).tc
    weights = sum(one.nbytes for one in tc.state_dict().values())
    assert needs["collect.envs"] - without == pytest.approx(1e-6 * weights)


def test_a_checkpoint_is_written_beside_the_former_one(
    needs: Needs, tmp_path: Path
) -> None:
    config = explore_settings("reward=random")
    policy = sum(one.nbytes for one in make_policy(config).state_dict().values())
    ask(config, tmp_path)
    # Weights and two numbers of the optimiser, twice; policy.pt; 4 MB of pictures.
    assert needs["hydra.run.dir"] == pytest.approx(4 + 7 * policy * 1e-6)
    assert "pretraining.folder" not in needs
    ask(explore_settings("reward=random", f"resume={tmp_path}"), tmp_path)
    assert needs["resume"] == needs["hydra.run.dir"]


def test_a_pretraining_that_is_found_needs_nothing(
    needs: Needs, tmp_path: Path
) -> None:
    config = explore_settings(f"pretraining.folder={tmp_path}")
    ask(config, tmp_path)
    assert needs.pop("pretraining.folder") > 4
    folder = pretraining_folder(config)
    folder.mkdir()
    save_networks(
        make_networks(config.model, world_of(config).spec), folder / "networks.pt"
    )
    ask(config, tmp_path)
    assert "pretraining.folder" not in needs


def test_a_pretraining_needs_room_for_its_batches(needs: Needs, tmp_path: Path) -> None:
    config = settings("pretrain", "scale=smoke", "collect.workers=2")
    assert isinstance(config, PretrainConfig)
    worlds = make_worlds(config)
    networks = make_networks(config.model, worlds[0].spec).modules
    require_pretrain_room(config, worlds, networks, tmp_path)
    # Two processes with 128 views of 60 x 80 and 4 engines each.
    views, engines = 128 * 60 * 80 * 3, 4 * 96 * 1024
    assert needs["collect.batch"] == pytest.approx(2 * (views + engines) * 1e-6)
    assert needs["hydra.run.dir"] > 4


def test_a_pretraining_needs_a_short_temporary_folder(
    needs: Needs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = settings("pretrain", "scale=smoke")
    assert isinstance(config, PretrainConfig)
    worlds = make_worlds(config)
    networks = make_networks(config.model, worlds[0].spec).modules
    for length in (71, 72):
        folder = "/" + "x" * (length - 1)
        monkeypatch.setattr(tempfile, "tempdir", folder)
        if length == 72:
            rule = rf"^TMPDIR must be at most 71 bytes long.*got '{folder}'$"
            with pytest.raises(SettingsError, match=rule):
                require_pretrain_room(config, worlds, networks, tmp_path)
        else:
            require_pretrain_room(config, worlds, networks, tmp_path)


SMOKE = ("scale=smoke", "reward=random", "evaluate.random_folder=kept")


@contextmanager
def run_on(folder: Path, **options: Any) -> Iterator[None]:
    """A disk in a folder, with a finished run if it fits; notes what else was left."""
    with disk(folder / "disk", **options):
        if options["size"] == "100k":
            make_exploration(folder / "disk", best=[0.9])
        try:
            yield
        finally:
            left = [*(folder / "disk").glob("*run*"), *folder.glob("run")]
            (folder / "left").write_text(" ".join(map(str, left)))


@needs_mounts
@pytest.mark.parametrize(
    ("recipe", "words", "size", "sentence"),
    [
        (
            "explore",
            SMOKE,
            "2m",
            "hydra.run.dir must name a folder on a disk with room for ",
        ),
        (
            "explore",
            ("scale=smoke", "pretraining.folder=disk/kept", "hydra.run.dir=run"),
            "2m",
            "pretraining.folder must name a folder on a disk with room for ",
        ),
        (
            "explore",
            (*SMOKE, "evaluate.random_folder=disk/kept", "hydra.run.dir=run"),
            "100k",
            "evaluate.random_folder must name a folder on a disk with room for 1 MB",
        ),
        (
            "pretrain",
            ("scale=smoke",),
            "2m",
            "hydra.run.dir must name a folder on a disk with room for ",
        ),
        (
            "tour",
            ("scale=smoke",),
            "100k",
            "hydra.run.dir must name a folder on a disk with room for 1 MB",
        ),
        (
            "report",
            ("folder=disk",),
            "100k",
            "folder must name a folder on a disk with room for 1 MB",
        ),
    ],
)
def test_a_disk_that_is_nearly_full_is_refused_before_anything_starts(
    tmp_path: Path, recipe: str, words: tuple[str, ...], size: str, sentence: str
) -> None:
    (tmp_path / "disk").mkdir()
    where = [] if recipe == "report" else ["hydra.run.dir=disk/run"]

    inside = run_on(tmp_path, size=size)
    done = run_forked(recipe, *where, *words, cwd=tmp_path, inside=inside)
    assert done.returncode == 2
    (said,) = done.stderr.splitlines()
    assert said.startswith(f"{recipe}: {sentence}")
    assert (tmp_path / "left").read_text() == ""


@needs_mounts
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"size": "4k"}, "/config/hydra.yaml' (No space left on device)"),
        ({"size": "1m", "read_only": True}, "' (Read-only file system)"),
    ],
)
def test_a_disk_that_is_full_to_the_last_byte_or_read_only_is_refused(
    tmp_path: Path, options: dict[str, Any], said: str
) -> None:
    (tmp_path / "disk").mkdir()
    where = f"hydra.run.dir={tmp_path}/disk/run"
    inside = run_on(tmp_path, **options)
    done = run_forked("tour", where, "scale=smoke", cwd=tmp_path, inside=inside)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: hydra.run.dir must name a folder that can be made and written to, got "
        f"'{tmp_path}/disk/run{said}\n",
    )
    assert (tmp_path / "left").read_text() == ""


@needs_mounts
def test_too_little_shared_memory_is_refused_before_anything_starts(
    tmp_path: Path,
) -> None:
    memory = Path("/dev/shm")
    done = run_forked("explore", *SMOKE, cwd=tmp_path, inside=disk(memory, "1m"))
    assert done.returncode == 2
    assert done.stderr.startswith("explore: /dev/shm must have room for 7 MB, which ")
    assert done.stderr.endswith(" got 1.0 MB; in Docker, --shm-size sets it\n")
    done = run_forked(
        *("tour", "scale=smoke"),
        cwd=tmp_path,
        inside=disk(memory, "1m", read_only=True),
    )
    assert (done.returncode, done.stderr) == (
        1,
        "tour: /dev/shm must have room for 96 kB of the engine's, got none (Read-only "
        "file system)\n",
    )
    assert not list(tmp_path.iterdir())


def test_walks_that_no_memory_holds_are_refused(needs: Needs, tmp_path: Path) -> None:
    """512 bytes for each of 10^12: 512,000,000 MB."""
    given = ("pretrained=package:maze3", "locomotion.memory=1000000000000")
    found = settings("explore", *given, f"evaluate.random_folder={tmp_path}")
    assert isinstance(found, ExploreConfig)
    rule = "^locomotion.memory must be smaller, or the machine have 512000000 MB "
    with pytest.raises(SettingsError, match=rule):
        ask(found, tmp_path)
