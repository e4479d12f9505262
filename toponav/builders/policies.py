"""The file of an explorer's policy."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor, nn

from toponav.runs import reading_checkpoint, save_atomically

_POLICY = {"kind": "toponav policy", "version": 1}
_POLICY_FILE = "policy.pt"


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
    file = Path(path)
    file = file / _POLICY_FILE if file.is_dir() else file
    with reading_checkpoint(file, setting, _POLICY, "a policy") as found:
        policy.load_state_dict(found["weights"])
