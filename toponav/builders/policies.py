"""The file of an explorer's policy."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from torch import Tensor, nn

from toponav.runs import (
    load_weights,
    reading_checkpoint,
    require_like,
    save_atomically,
)

_POLICY = {"kind": "toponav policy", "version": 1}
_POLICY_FILE = "policy.pt"
_Policy = TypeVar("_Policy", bound=nn.Module)


def save_policy(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``policy.pt``, an explorer's weights, atomically."""
    kept: dict[str, object] = {**_POLICY, "weights": dict(weights)}
    save_atomically(kept, folder / _POLICY_FILE)


def load_policy(
    path: Path | str, policy: nn.Module, *, setting: str = "init_policy"
) -> None:
    """Read what `save_policy` wrote into a policy; ``path`` is the file or its folder.

    Raises:
        SettingsError: if there is none, it is damaged or of other settings; the
            sentence names the ``setting`` that has the path.
    """
    with _reading(path, setting) as weights:
        require_like(weights, policy.state_dict())
        policy.load_state_dict(weights)


def load_new_policy(
    path: Path | str, make: Callable[[], _Policy], *, setting: str
) -> _Policy:
    """What ``make`` makes, as `load_policy` fills it, in ``eval()`` mode.

    Settings of another run may ask for one that is larger than its file: no memory is
    taken for that.
    """
    with _reading(path, setting) as weights:
        return load_weights(make, weights)


@contextmanager
def _reading(path: Path | str, setting: str) -> Iterator[dict[str, Tensor]]:
    """The weights in a file, to make something of them in the ``with`` block."""
    file = Path(path)
    file = file / _POLICY_FILE if file.is_dir() else file
    with reading_checkpoint(file, setting, _POLICY, "a policy") as found:
        yield found["weights"]
