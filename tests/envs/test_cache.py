"""The folder in which engines keep what they compile."""

import os
from pathlib import Path

import platformdirs
import pytest

from toponav.envs.cache import cache_folder


def test_it_is_in_the_users_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: str(tmp_path))
    assert cache_folder("wads") == cache_folder("wads") == tmp_path / "wads"
    assert cache_folder("maps") == tmp_path / "maps"
    # Nothing stays of the trial whether somebody can write there.
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "maps", tmp_path / "wads"]


@pytest.mark.parametrize("has_users", [True, False])
def test_without_a_cache_a_temporary_folder_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_users: bool
) -> None:
    # A file in the folder's place: nobody can write there, not even root.
    (tmp_path / "file").touch()
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: f"{tmp_path}/file")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    if not has_users:
        monkeypatch.delattr(os, "getuid")
    user = os.getuid() if has_users else "user"
    folder = cache_folder("maps")
    assert folder == tmp_path / f"toponav-{user}" / "maps"
    assert folder.is_dir()
