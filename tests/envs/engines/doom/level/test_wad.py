"""The WAD container."""

import pytest

from tests.envs.doom_files import lumps_of
from toponav.envs.engines.doom.level.wad import build_wad, lump_names


def test_lumps_come_back_in_order() -> None:
    lumps = [("MAP01", b""), ("TEXTMAP", b"abc"), ("ENDMAP", b""), ("TEXTMAP", b"\0\1")]
    assert lumps_of(build_wad(lumps)) == lumps


def test_no_lumps_are_a_header() -> None:
    assert build_wad([]) == b"PWAD" + bytes(4) + bytes([12, 0, 0, 0])


def test_a_long_name_is_refused() -> None:
    with pytest.raises(ValueError, match="at most 8 letters, got 'NINELONG9'"):
        build_wad([("NINELONG9", b"")])


@pytest.mark.parametrize(
    "content", [b"", b"PWAD", b"\x7fELF" + bytes(100), build_wad([("A", b"a")])[:-1]]
)
def test_what_is_no_whole_wad_has_no_lumps(content: bytes) -> None:
    assert lump_names(content) == []
