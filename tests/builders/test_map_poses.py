"""The file that says where the waypoints of a map truly are."""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from toponav.builders import POSES_FILE, load_poses, name_contents, next_path
from toponav.config import SettingsError

POSES = np.arange(15, dtype=np.float32).reshape(5, 3)


def load(path: Path, about: Mapping[str, str] = {}) -> torch.Tensor:
    return load_poses(path.parent, about, num_waypoints=5, setting="run")


def array(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def header(*shape: int, kind: str = "<f4") -> bytes:
    """An array with room for nothing, whatever its header says."""
    file = io.BytesIO()
    about = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, about)
    return file.getvalue()


@pytest.mark.parametrize("kind", ["<f4", "<f8", "<f2", "<i8", "<u2", np.longdouble])
def test_numbers_of_every_kind_are_read(tmp_path: Path, kind: str) -> None:
    path = tmp_path / POSES_FILE
    np.save(path, POSES.astype(kind))
    found = load(path)
    assert found.dtype == torch.float32
    assert torch.equal(found, torch.from_numpy(POSES))
    np.save(path, np.asfortranarray(POSES.astype(kind)))
    assert torch.equal(load(path), found)


#: What is no whole file of finite numbers.
DAMAGED = {
    "infinite": array(np.full((5, 3), np.inf)),
    "infinite once rounded": array(np.full((5, 3), 1e300)),
    "cut": array(POSES)[:-1],
    "words": array(np.full((5, 3), "x")),
    "truths": array(np.ones((5, 3), bool)),
    # As an accident with one bit leaves it, or another machine.
    "turned round": array(POSES.astype(">f4")),
    "structured": array(np.zeros((5, 3), [("a", "<f4")])),
    "terabytes": header(10**12, 3),
    "more than can be counted to": header(10**18, 3),
    "terabytes of a word": header(5, 3, kind="<U1000000000"),
    "negative": header(-5, 3),
    "a bracket": array(POSES).replace(b"(5, 3)", b"(5, (("),
    "of another Python": array(POSES).replace(b"(5, 3)", b"(5L,3)"),
    "an archive": b"PK\x03\x04" + bytes(100),
    "empty": b"",
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("how", DAMAGED)
def test_a_damaged_file_is_refused_by_its_path(tmp_path: Path, how: str) -> None:
    path = tmp_path / POSES_FILE
    path.write_bytes(DAMAGED[how])
    with pytest.raises(SettingsError) as caught:
        load(path)
    said = str(caught.value)
    assert said.startswith(f"run must name a complete file, got the damaged {path} (")
    assert "\n" not in said


@pytest.mark.parametrize("shape", [(6, 3), (5, 2), (5,), (3, 5), (5, 3, 1), (0, 3), ()])
def test_other_poses_than_the_maps_are_refused(tmp_path: Path, shape) -> None:
    path = tmp_path / POSES_FILE
    np.save(path, np.zeros(shape, np.float32))
    rule = "run must name an exploration whose map_poses.npy has a row of three for eac"
    with pytest.raises(SettingsError, match=f"^{rule}h of 5 waypoints, got "):
        load(path)


def test_poses_of_another_map_are_refused(tmp_path: Path) -> None:
    path = next_path(tmp_path / POSES_FILE)
    np.save(path, POSES)
    about = name_contents(tmp_path)
    assert torch.equal(load(path, about), torch.from_numpy(POSES))
    np.save(path, POSES + 1)
    rule = "whose map_poses.npy belongs to its map.zip, got that of another map in"
    with pytest.raises(SettingsError, match=rule):
        load(path, about)
