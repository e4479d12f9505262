"""The views of a map in a file: written once, whole whenever the process ends."""

import io
import os
from pathlib import Path

import pytest
import torch
from PIL import Image

from tests.graph.grey_world import compare, embed, episode
from toponav.graph import (
    MapRules,
    TopologicalMap,
    ViewFile,
    decode_view,
    load_map,
    save_map,
    views,
)


def some(number: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(number)
    return torch.randint(0, 256, (6, 8, 3), generator=generator, dtype=torch.uint8)


def filled(path: Path, num: int) -> ViewFile:
    found = ViewFile(path)
    for number in range(num):
        found.append(some(number))
    return found


def test_it_reads_what_was_added(tmp_path: Path) -> None:
    found = filled(tmp_path / "views", 5)
    assert torch.equal(found.read(1, 4), torch.stack([some(1), some(2), some(3)]))
    found.keep([0, 3])
    found.append(some(7))
    assert torch.equal(found.read(0, 9), torch.stack([some(0), some(3), some(7)]))
    assert not len(filled(tmp_path / "none", 0).read(0, 9))


def test_a_state_holds_until_the_file_is_changed(tmp_path: Path) -> None:
    path = tmp_path / "views"
    found = filled(path, 3)
    state = found.state_dict()
    # What came after the state is overwritten.
    found.append(some(8))
    again = ViewFile(path)
    again.load_state_dict(state)
    assert path.stat().st_size == state["views_size"]
    again.append(some(3))
    assert torch.equal(again.read(0, 9), torch.stack([some(one) for one in range(4)]))
    data = bytearray(path.read_bytes())
    data[50] ^= 1
    for damaged in (bytes(data), bytes(data[:40])):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="views must be as it was written"):
            ViewFile(path).load_state_dict(state)


def test_a_picture_is_read_when_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, read, pread = filled(tmp_path / "views", 5), [], os.pread

    def note(*given: int) -> bytes:
        read.append(given)
        return pread(*given)

    monkeypatch.setattr(os, "pread", note)
    pictures = found.pictures()
    # What comes later belongs to a later map.
    found.append(some(5))
    found.keep([1, 2])
    assert len(pictures) == 5
    assert torch.equal(decode_view(pictures[3]), some(3))
    assert len(read) == 1
    later = [decode_view(one) for one in pictures[1:3]]
    assert torch.equal(torch.stack(later), torch.stack([some(1), some(2)]))
    assert len(read) == 3


def test_states_of_earlier_versions_are_read(tmp_path: Path) -> None:
    found = filled(tmp_path / "views", 2)
    found.load_state_dict({"images": torch.stack([some(4), some(5), some(6)])})
    assert torch.equal(found.read(1, 3), torch.stack([some(5), some(6)]))


def make_map(path: Path | None = None, **rules: object) -> TopologicalMap:
    literal = {"window": 0, "search_window": 0, "hysteresis": False, "nearby": None}
    given = MapRules(tc_threshold=0.9, tc_reach=0.75, **literal | rules)  # type: ignore[arg-type]
    return TopologicalMap(embed, compare, given, views=path and ViewFile(path))


def test_each_view_is_encoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded, encode = [], views.encode_view
    monkeypatch.setattr(
        views, "encode_view", lambda one: encoded.append(1) or encode(one)
    )
    monkeypatch.setattr("toponav.graph.map_file.encode_view", views.encode_view)
    found, plain = make_map(tmp_path / "views"), make_map()
    for one in (found, plain):
        one.add_episode(episode(0, 20, 60, 20, views=True))
    state = found.state_dict()
    assert "images" not in state
    for name in ("one.zip", "two.zip"):
        pictures = found.waypoints.views.pictures()
        save_map(found.state_dict(views=False), tmp_path / name, views=pictures)
    assert len(encoded) == 3
    loaded, _ = load_map(tmp_path / "two.zip")
    assert torch.equal(loaded["images"], plain.waypoints.images)
    # A file with the same views is the same file.
    save_map(plain.state_dict(), tmp_path / "plain.zip")
    assert (tmp_path / "plain.zip").read_bytes() == (tmp_path / "two.zip").read_bytes()
    found.refresh(1)
    assert torch.allclose(found.embeddings, plain.embeddings)


def test_a_state_has_views_or_what_was_made_of_them(tmp_path: Path) -> None:
    found, other = make_map(tmp_path / "views"), make_map(tmp_path / "views")
    found.add_episode(episode(0, 20, 60, views=True))
    state = found.state_dict(embeddings=False)
    assert not {"embeddings", "prepared"} & set(state)
    other.load_state_dict(state)
    assert other.num_waypoints == 3
    other.refresh(found.network_version)
    assert torch.allclose(other.embeddings, found.embeddings)
    assert torch.equal(other.prepared, other.embeddings)
    with pytest.raises(ValueError, match="a state must have views or embeddings, got"):
        found.state_dict(views=False, embeddings=False)


@pytest.mark.parametrize("in_file", [False, True])
def test_a_state_without_views_leaves_a_map_without(tmp_path, in_file) -> None:
    path = tmp_path / "views" if in_file else None
    found = make_map(path)
    found.add_episode(episode(0, 20, 60, views=True))
    found.load_state_dict(found.state_dict(views=False))
    assert (found.num_waypoints, len(found.waypoints.images)) == (3, 0)
    assert found.add_episode(episode(0, 20, 90)).tolist() == [0, 1, 3]
    with pytest.raises(ValueError, match="views must have been given to refresh a map"):
        found.refresh(1)


def test_places_in_a_file_are_no_views_in_memory(tmp_path: Path) -> None:
    found = make_map(tmp_path / "views")
    found.add_episode(episode(0, 20, 60, views=True))
    with pytest.raises(ValueError, match="views must be kept in a file to load those"):
        make_map().load_state_dict(found.state_dict())


def test_what_a_full_map_has_no_waypoint_for_is_nowhere() -> None:
    found = make_map(capacity=2, edges="time")
    assert found.add_episode(episode(0, 20, 60, 80, 20, 0)).tolist() == [
        *(0, 1, -1, -1, 1, 0),
    ]
    # No edge leads across what is nowhere, but known places join as before.
    assert found.num_waypoints == 2
    assert found.edges.tolist() == [[0, 1]]
    assert found.graph.traversals.tolist() == [[1, 1]]
    backed = make_map(capacity=2, edges="time", nearby=1)
    assert backed.add_episode(episode(0, 60, 20, 60, 0)).tolist() == [0, 1, -1, 1, 0]
    assert backed.graph.traversals.tolist() == [[1, 1]]


def test_a_map_takes_views_with_channels_first() -> None:
    rules = MapRules(tc_threshold=0.9, tc_reach=0.75, window=0, search_window=0)
    data = episode(0, 30, 60, views=True).exclude("embedding")

    def embed_first(views: torch.Tensor) -> torch.Tensor:
        assert views.shape[1:] == (3, 2, 2)
        return embed(views)

    usual = TopologicalMap(embed, compare, rules)
    other = TopologicalMap(embed_first, compare, rules, channels="CHW")
    usual.add_episode(data)
    first = data.clone()
    first["network_pixels"] = first["network_pixels"].movedim(-1, -3)
    other.add_episode(first)
    assert first["network_pixels"].shape == (3, 3, 2, 2)
    assert torch.equal(usual.waypoints.images, other.waypoints.images)
    other.refresh(1)
    assert torch.equal(usual.embeddings, other.embeddings)
    wide = torch.zeros(3, 3, 4, 5, dtype=torch.uint8)
    with pytest.raises(ValueError, match=r"network_pixels' must be .* channels='CHW'"):
        usual.add_episode(first.set("network_pixels", wide))


@pytest.mark.parametrize("place", [(0, 10**9), (-1, 20), (10**9, 20), (0, 0)])
def test_a_view_outside_of_the_file_is_refused(tmp_path, place) -> None:
    views = ViewFile(tmp_path / "views")
    views.append(torch.zeros(4, 6, 3, dtype=torch.uint8))
    state = views.state_dict() | {"views": torch.tensor([place])}
    before = (tmp_path / "views").read_bytes()
    with pytest.raises(ValueError, match="places in views must be inside of it, got"):
        ViewFile(tmp_path / "views").load_state_dict(state)
    assert (tmp_path / "views").read_bytes() == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is full")
def test_a_full_disk_is_said_with_the_file() -> None:
    full = ViewFile(Path("/dev/full"))
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        full.append(torch.zeros(4, 6, 3, dtype=torch.uint8))
    assert len(full) == 0


def test_a_view_of_another_format_is_refused() -> None:
    buffer = io.BytesIO()
    Image.fromarray(some(0).numpy()).save(buffer, "BMP")
    with pytest.raises(ValueError, match="a view that is no PNG"):
        decode_view(buffer.getvalue())
