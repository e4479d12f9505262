"""A device that is not the processor, on machines that have none.

    python tests/stand_in_device.py recipes/pretrain.py device=cpu:1 scale=smoke

runs a script in which ``cpu:1`` is a device of its own, as far as a script can tell: a
tensor made there or moved there says so, and an operation on tensors of two devices is
refused wherever a GPU would refuse it. It computes on the processor. Other processes
that the script starts know no such device, as they know no GPU here, unless they enter
it (`tests/stand_in_workers.py`). `HostWaits` tells where a GPU would be waited for.
"""

import runpy
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

NAME = "cpu:1"
DEVICE = torch.device(NAME)
#: Operations that may see two devices: copies from one to the other.
_COPIES = {"aten._to_copy", "aten.copy_", "aten._copy_from", "aten._foreach_copy_"}
#: Lengths, the second argument and the second result, lie on the processor always.
_PACKING = ("aten._pack_padded_sequence", "aten._pad_packed_sequence")
#: Operations whose indices may lie on the processor, the others on the device.
_INDEXING = {
    "aten.index",
    "aten.index_put",
    "aten.index_put_",
    "aten._index_put_impl_",
    "aten._unsafe_index_put",
}
#: Operations whose results the host must know, be it only their size.
_READING = {
    "aten._local_scalar_dense",
    "aten.equal",
    "aten.masked_select",
    "aten.nonzero",
    "aten._unique2",
    "aten.unique_dim",
}
#: What notes them while it is entered.
_watching: "HostWaits | None" = None


class DeviceTensor(Tensor):
    """A tensor on the stand-in device; ``held`` has its numbers."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "DeviceTensor":
        tensor = Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
        )
        tensor.held = held
        return tensor

    def __repr__(self) -> str:  # type: ignore[override]
        return f"{self.held!r} on {NAME}"

    def tolist(self):
        _note("tolist")
        return self.held.tolist()

    def numpy(self, *, force: bool = False):
        if not force:
            raise TypeError(f"a tensor on {NAME} has no numpy(); copy it by cpu()")
        _note("numpy")
        return self.held.numpy(force=True)

    def __array__(self, dtype=None):
        return self.numpy()

    def __reduce_ex__(self, protocol):
        # To a file, or to another process: all that is read here is read to the
        # processor, which is where the other process has it.
        kept = self.held.detach().requires_grad_(self.requires_grad)
        return kept.__reduce_ex__(protocol)

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class StandInDevice(TorchDispatchMode):
    """While it is entered, ``cpu:1`` is a device of its own."""

    def __enter__(self):
        self._apply = apply = nn.Module._apply

        def swapping_apply(module: nn.Module, *args: Any) -> nn.Module:
            # A parameter of another class cannot be set into the old one's place.
            torch.__future__.set_swap_module_params_on_conversion(True)
            try:
                return apply(module, *args)
            finally:
                torch.__future__.set_swap_module_params_on_conversion(False)

        nn.Module._apply = swapping_apply  # type: ignore[method-assign]
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        nn.Module._apply = self._apply  # type: ignore[method-assign]
        super().__exit__(*error)

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class HostWaits(TorchFunctionMode):
    """Where a host with a GPU would wait for it, while this is entered: `names`.

    That is where numbers are read, where a size depends on them, and at copies that are
    not allowed to be under way (``non_blocking``).
    """

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __enter__(self):
        self._watch(self)
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        self._watch(None)
        super().__exit__(*error)

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if func is not torch.nn.functional.one_hot:
            return func(*args, **(kwargs or {}))
        # It looks at the numbers on the processor alone.
        self._watch(None)
        result = func(*args, **(kwargs or {}))
        self._watch(self)
        return result

    @staticmethod
    def _watch(who: "HostWaits | None") -> None:
        global _watching
        _watching = who


def _note(name: str) -> None:
    if _watching is not None:
        _watching.names.append(name)


def _must_wait(name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
    """Whether the host waits for a GPU that is asked for this."""
    if name == "aten._to_copy":
        goes = kwargs.get("device") not in (None, args[0].device)
        return goes and not kwargs.get("non_blocking")
    if name in ("aten.copy_", "aten._foreach_copy_"):
        is_async = kwargs.get("non_blocking") or args[2:] == (True,)
        # A number that is copied goes with the call.
        pairs = zip(*map(_tensors, args[:2]), strict=False)
        goes = any(to.device != source.device for to, source in pairs)
        return goes and not is_async
    if not any(isinstance(one, DeviceTensor) for one in _tensors((args, kwargs))):
        return False
    masks = args[1] if name in _INDEXING else ()
    return name in _READING or any(
        one is not None and one.dtype in (torch.bool, torch.uint8) for one in masks
    )


def _run(func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Compute on the processor; the result lies where it would lie on a GPU."""
    name = _name_of(func)
    if _watching is not None and _must_wait(name, args, kwargs):
        _note(name)
    tensors = list(_tensors((args, kwargs)))
    is_there = any(isinstance(one, DeviceTensor) for one in tensors)
    asked: torch.device | None = kwargs.get("device")
    _refuse_mixtures(name, args, tensors, is_there)
    held = {"device": torch.device("cpu")} if asked is not None else {}
    plain_args = tuple(_map(_held, one) for one in args)
    plain_kwargs = {key: _map(_held, one) for key, one in kwargs.items()}
    result = func(*plain_args, **plain_kwargs | held)
    if func._schema.is_mutable and not func._schema.returns:
        return result
    # What is changed in place stays the same object.
    changed = (
        {id(_held(one)): one for one in tensors} if func._schema.is_mutable else {}
    )
    moves = is_there if asked is None else asked == DEVICE and asked.index == 1

    def put(one: Any) -> Any:
        if not isinstance(one, Tensor):
            return one
        if id(one) in changed:
            return changed[id(one)]
        return DeviceTensor(one) if moves else one

    if name in _PACKING:
        return put(result[0]), result[1]
    return _map(put, result)


# Torch's own walk through arguments takes several times the rest, for each operation.
def _map(change: Callable[[Any], Any], one: Any) -> Any:
    if isinstance(one, (list, tuple)):
        changed = [_map(change, part) for part in one]
        return changed if isinstance(one, list) else tuple(changed)
    return change(one)


def _tensors(one: Any) -> Iterator[Tensor]:
    if isinstance(one, Tensor):
        yield one
    elif isinstance(one, (list, tuple)):
        for part in one:
            yield from _tensors(part)
    elif isinstance(one, dict):
        yield from _tensors(list(one.values()))


@cache
def _name_of(func: Any) -> str:
    return str(func).rpartition(".")[0]


def _held(one: Any) -> Any:
    return one.held if isinstance(one, DeviceTensor) else one


def _refuse_mixtures(
    name: str, args: tuple[Any, ...], tensors: list[Tensor], is_there: bool
) -> None:
    """Raise RuntimeError where a GPU would, for tensors of two devices."""
    if name in _COPIES or not is_there:
        return
    if name in _INDEXING:
        indices = list(_tensors(args[1]))
        if not isinstance(args[0], DeviceTensor):
            _require(name, indices, there=False)
        tensors = list(_tensors((args[0], *args[2:])))
    if name in _PACKING:
        _require(name, [args[1]], there=False)
        tensors = list(_tensors((args[0], *args[2:])))
    # A number from the processor, of no dimension, may go with tensors of a device.
    if any(isinstance(one, DeviceTensor) for one in tensors):
        _require(name, [one for one in tensors if one.dim() > 0], there=True)


def _require(name: str, tensors: list[Tensor], *, there: bool) -> None:
    if any(isinstance(one, DeviceTensor) != there for one in tensors):
        shapes = [(list(one.shape), str(one.device)) for one in tensors]
        raise RuntimeError(
            f"all tensors must be on the same device for {name}, got {shapes}"
        )


if __name__ == "__main__":
    del sys.argv[0]
    sys.path[0] = str(Path(sys.argv[0]).parent)
    with StandInDevice():
        runpy.run_path(sys.argv[0], run_name="__main__")
