"""The views of a map's waypoints: in memory, or in a file that only grows."""

import io
import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, overload

import numpy as np
import torch
from PIL import Image, UnidentifiedImageError
from torch import Tensor

_PIECE = 1 << 20  # bytes


class Views(Protocol):
    """Views uint8 ``[H, W, 3]`` by the numbers of their waypoints."""

    def __len__(self) -> int: ...

    def append(self, view: Tensor) -> None:
        """Add the view of the next waypoint."""

    def read(self, first: int, last: int) -> Tensor:
        """Those from ``first`` to before ``last``, ``[N, H, W, 3]``."""

    def pictures(self) -> Sequence[Tensor | bytes]:
        """All that there are now; those of a file are PNG, each read if asked for.

        A thread may read them while more are added.
        """

    def keep(self, kept: list[int]) -> None:
        """Drop all but these, which get new numbers."""

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs to have them again."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Have those of a checkpoint, and no others; none, if it was left without."""


class ViewsInMemory:
    """Views as they are."""

    def __init__(self) -> None:
        self._views: list[Tensor] = []

    def __len__(self) -> int:
        return len(self._views)

    def append(self, view: Tensor) -> None:
        self._views.append(view.clone())

    def read(self, first: int, last: int) -> Tensor:
        views = self._views[first:last]
        return torch.stack(views) if views else torch.empty(0)

    def pictures(self) -> Sequence[Tensor | bytes]:
        return self._views[:]

    def keep(self, kept: list[int]) -> None:
        self._views = [self._views[one] for one in kept]

    def state_dict(self) -> dict[str, Any]:
        return {"images": self.read(0, len(self))}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        if "views" in state:
            rule = "views must be kept in a file to load those of one"
            raise ValueError(f"{rule}, got a map that keeps them in memory")
        self._views = list(state.get("images", torch.empty(0)).clone())


class _Pictures(Sequence[bytes]):
    """Parts of a file, from where each begins and as long as it is, in bytes."""

    def __init__(self, file: io.FileIO, places: list[tuple[int, int]]) -> None:
        self._file, self._places = file, places

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, at: int) -> bytes: ...
    @overload
    def __getitem__(self, at: slice) -> "_Pictures": ...
    def __getitem__(self, at: int | slice) -> "bytes | _Pictures":
        if isinstance(at, slice):
            return _Pictures(self._file, self._places[at])
        begin, length = self._places[at]
        return os.pread(self._file.fileno(), length, begin)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name the file in an ``OSError`` of the block, which a full disk does not."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


class ViewFile:
    """Views as PNG, one after another in a file, each encoded and written once.

    The state says how much of the file belongs to it, and that part never changes: a
    state that is saved while the file grows fits it whenever the process ends.

    Examples:
        >>> import tempfile
        >>> views = ViewFile(Path(tempfile.mkdtemp()) / "views")
        >>> views.append(torch.zeros(4, 6, 3, dtype=torch.uint8))
        >>> views.read(0, 1).shape
        torch.Size([1, 4, 6, 3])
    """

    def __init__(self, path: Path) -> None:
        path.touch()
        self.path = path
        self._file = path.open("r+b", buffering=0)
        #: Where each view begins, and its length in bytes.
        self._places: list[tuple[int, int]] = []
        #: Bytes that are in use, and their checksum.
        self._size = self._checksum = 0

    def __len__(self) -> int:
        return len(self._places)

    def append(self, view: Tensor) -> None:
        data = encode_view(view)
        at = self._size
        left = memoryview(data)
        with naming(self.path):
            self._file.seek(at)
            while left:
                left = left[self._file.write(left) :]
        self._size += len(data)
        self._checksum = zlib.crc32(data, self._checksum)
        self._places.append((at, len(data)))

    def read(self, first: int, last: int) -> Tensor:
        places = self._places[first:last]
        found = [decode_view(one) for one in _Pictures(self._file, places)]
        return torch.stack(found) if found else torch.empty(0)

    def pictures(self) -> "_Pictures":
        return _Pictures(self._file, self._places[:])

    def keep(self, kept: list[int]) -> None:
        self._places = [self._places[one] for one in kept]

    def state_dict(self) -> dict[str, Any]:
        """Where the views are in the file, which is on disk when this returns."""
        os.fsync(self._file.fileno())
        return {
            "views": torch.tensor(self._places).reshape(-1, 2),
            "views_size": self._size,
            "views_checksum": self._checksum,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken; ``ValueError`` if the file changed."""
        self._places, self._size, self._checksum = [], 0, 0
        if "views" not in state:  # of an earlier version, in memory, or left out
            for view in state.get("images", ()):
                self.append(view)
            return
        checksum, left = 0, int(state["views_size"])
        self._file.seek(0)
        while left and (piece := self._file.read(min(left, _PIECE))):
            checksum, left = zlib.crc32(piece, checksum), left - len(piece)
        if left or checksum != state["views_checksum"]:
            raise ValueError(f"{self.path.name} must be as it was written")
        size = int(state["views_size"])
        places = [(at, length) for at, length in state["views"].tolist()]
        for at, length in places:
            if not 0 <= at < at + length <= size:
                rule = f"places in {self.path.name} must be inside of it"
                raise ValueError(f"{rule}, got {length} bytes from {at} of {size}")
        self._places, self._size, self._checksum = places, size, checksum
        self._file.truncate(self._size)


def encode_view(view: Tensor) -> bytes:
    """A PNG of a view, uint8 ``[H, W, 3]``."""
    if view.dtype is not torch.uint8 or view.ndim != 3 or view.shape[-1] != 3:
        raise ValueError(
            f"views must be uint8 [H, W, 3], got {view.dtype} {list(view.shape)}"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(view)).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def decode_view(data: bytes) -> Tensor:
    """The view of a PNG."""
    return torch.from_numpy(np.array(open_view(data)))


def open_view(data: bytes) -> Image.Image:
    """A PNG of which only the size is read yet; ``ValueError`` if it is none.

    Of other formats that is not all: some are decoded to know their size, which has no
    limit then, and some are read by another program.
    """
    try:
        picture = Image.open(io.BytesIO(data), formats=["PNG"])
    except UnidentifiedImageError as bad:
        raise ValueError("a view that is no PNG") from bad
    # A text or colour profile, which `encode_view` does not write, is kept in memory
    # and may be a thousand times as long as its part of the file.
    if picture.info:
        raise ValueError("a view that holds more than its pixels")
    return picture
