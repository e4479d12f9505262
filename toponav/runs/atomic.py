"""`replacing`: writes a file so that readers see the old one or the new one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Give a temporary path in the same folder; on success it replaces ``path``.

    Both have the same suffix. After an error ``path`` is untouched.

    Examples:
        >>> import tempfile
        >>> with replacing(tempfile.mkdtemp() + "/notes.txt") as temporary:
        ...     _ = temporary.write_text("complete")
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        # The bytes are on disk before the file is renamed.
        with temporary.open("r+b") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
