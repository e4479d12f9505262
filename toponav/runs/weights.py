"""Weights in files: that they are numbers, and those of a network that is to be made.

What a file says of a network's size is compared with its weights before memory is taken
for such a network.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

# Under these keys files hold weights and what trains them.
_TRAINED = {"weights", "policy", "optimizer", "head", "reward", "offsets", "ground"}
# Of what inputs are scaled by, the least that training leaves.
_LEAST = {"running_var": 0.0, "spread": 1e-6}
# Far more than any network has of anything.
_LARGEST = 2**31
_Module = TypeVar("_Module", bound=nn.Module)


def not_finite(entries: Any, name: str = "", *, trained: bool = False) -> Iterator[str]:
    """What is wrong with tensors of networks and optimisers, and with which.

    Examples:
        >>> list(not_finite({"weights": {"mean": torch.tensor(torch.nan)}}))
        ['NaN or infinity in weights.mean']
    """
    if isinstance(entries, Mapping):
        for key, value in entries.items():
            inside = f"{name}.{key}" if trained else str(key)
            yield from not_finite(
                value, inside, trained=trained or str(key) in _TRAINED
            )
    elif trained and isinstance(entries, Tensor):
        if not is_plain(entries):
            yield f"no plain numbers in {name}"
        # In float32, which networks compute in.
        elif not entries.float().isfinite().all():
            yield f"NaN or infinity in {name}"


def is_plain(found: object) -> bool:
    """Whether a tensor has a real number in memory for each of its entries.

    Those that are sparse, complex, quantised, on a device without memory, or of one
    number that is repeated can be written, and no network can be filled with them.

    Examples:
        >>> is_plain(torch.zeros(3)), is_plain(torch.zeros(3).to_sparse())
        (True, False)
        >>> is_plain(torch.zeros(1).expand(3))
        False
    """
    if not isinstance(found, Tensor) or found.layout is not torch.strided:
        return False
    if found.device.type == "meta" or found.is_complex() or found.is_quantized:
        return False
    return found.nbytes <= found.untyped_storage().nbytes()


def require_plain(weights: Mapping[str, object]) -> None:
    """Raise ``ValueError`` that names the first of some weights that is not plain."""
    for name, one in weights.items():
        if not is_plain(one):
            raise ValueError(f"{name} is no plain tensor")


def require_like(
    weights: Mapping[str, Tensor], like: Mapping[str, Tensor], *, rounded: bool = False
) -> None:
    """Refuse other weights than a network has, of which there need be no memory.

    Args:
        weights: what a file has.
        like: what `load_state_dict` needs, on any device.
        rounded: whether float16 will do.

    Raises:
        ValueError: that names the first that differs.

    Examples:
        >>> like = nn.Linear(3, 2).state_dict()
        >>> require_like({"weight": torch.zeros(2, 4), "bias": torch.zeros(2)}, like)
        Traceback (most recent call last):
        ValueError: weight is torch.float32 [2, 4], not torch.float32 [2, 3]
    """
    if other := like.keys() ^ weights.keys():
        raise ValueError(f"{min(other)} is there or is missing")
    require_plain(weights)
    for name, wanted in like.items():
        found = weights[name]
        half = rounded and wanted.is_floating_point() and found.dtype is torch.half
        kind = found.dtype if half else wanted.dtype
        if (found.dtype, found.shape) != (kind, wanted.shape):
            what = f"{found.dtype} {list(found.shape)}"
            raise ValueError(f"{name} is {what}, not {kind} {list(wanted.shape)}")
        # Inputs are divided by them, or by their root and a little more.
        least = _LEAST.get(name.rpartition(".")[2])
        if least is not None and not (found >= least).all():
            raise ValueError(f"{name} has a number below {least:g}")


def load_weights(make: Callable[[], _Module], weights: Mapping[str, Tensor]) -> _Module:
    """The network that ``make`` makes, with a file's weights, in ``eval()`` mode.

    It is made without memory first, to see whether they are its own.

    Raises:
        ValueError: if they are not.
    """
    # There, tensors have shapes and no content.
    with torch.device("meta"):
        like = make().state_dict()
    require_like(weights, like)
    network = make()
    network.load_state_dict(weights)
    return network.eval()


def read_counts(found: Mapping[str, Any], names: Iterable[str]) -> dict[str, int]:
    """What a file says of a network's sizes.

    Raises:
        ValueError: unless it names all, and each is a count that can be printed.

    Examples:
        >>> read_counts({"hidden": 16, "kind": "x"}, ["hidden"])
        {'hidden': 16}
    """
    if not isinstance(found, Mapping):
        raise ValueError(f"sizes must have names, got {type(found).__name__}")
    counts = {name: found[name] for name in names}
    for name, count in counts.items():
        if type(count) is not int or not 0 < count < _LARGEST:
            kind = type(count).__name__
            raise ValueError(f"{name} must be a count below {_LARGEST}, got {kind}")
    return counts
