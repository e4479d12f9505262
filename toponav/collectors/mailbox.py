"""`Mailbox`: weights in shared memory, published by one process, read by others."""

import time
from collections.abc import Mapping

import torch
from tensordict import TensorDict
from torch import Tensor, nn

#: What is published: a module (parameters and persistent buffers), or tensors by name.
Weights = nn.Module | Mapping[str, Tensor]

# The stamp is odd while a publication is being written.
_WRITING = 1


class MailboxError(RuntimeError):
    """A mailbox cannot be read, or its tensors do not fit the given module."""


class Mailbox:
    """Weights of several modules in shared memory, a version number with each.

    One process publishes under a name; any number of others pull, each when it likes.
    TorchRL's own shared memory applies updates whenever they arrive, so that one
    rollout may hold decisions of several versions. Give the mailbox to other processes
    with their arguments: a copy by ``cloudpickle``, such as of a closure, receives
    nothing.

    Args:
        modules: what is published, by name.
        versions: number of these first values by name, 0 unless given.

    Examples:
        >>> here, there = nn.Linear(2, 2), nn.Linear(2, 2)
        >>> mailbox = Mailbox({"policy": here})
        >>> mailbox.publish("policy", here), mailbox.pull("policy", there)
        (1, 1)
    """

    def __init__(
        self,
        modules: Mapping[str, Weights],
        *,
        versions: Mapping[str, int] | None = None,
    ) -> None:
        self.names = tuple(modules)
        self._slots: dict[str, TensorDict] = {}
        self._stamps: dict[str, Tensor] = {}
        for name, module in modules.items():
            tensors = {key: value.cpu() for key, value in tensors_of(module).items()}
            self._slots[name] = TensorDict(tensors).clone().share_memory_()
            stamp = torch.tensor(2 * (versions or {}).get(name, 0))
            self._stamps[name] = stamp.share_memory_()

    def version(self, name: str) -> int:
        """Number of the newest complete publication."""
        return int(self._stamps[name]) // 2

    def publish(self, name: str, module: Weights) -> int:
        """Publish new weights of the module ``name``; returns their version."""
        source = self._matching(name, module)
        stamp = self._stamps[name]
        stamp |= _WRITING
        for key, slot in self._slots[name].items():
            slot.copy_(source[key])
        stamp += 1
        return int(stamp) // 2

    def pull(self, name: str, module: Weights, *, timeout_s: float = 60.0) -> int:
        """Copy the newest weights into a module on any device; returns their version.

        No copy mixes two publications. MailboxError if the module does not fit, or none
        is complete within ``timeout_s``, as when the publisher died while it wrote.
        """
        target = self._matching(name, module)
        stamp, deadline = self._stamps[name], time.monotonic() + timeout_s
        while True:
            before = int(stamp)
            if not before & _WRITING:
                with torch.no_grad():
                    for key, slot in self._slots[name].items():
                        target[key].copy_(slot)
                if int(stamp) == before:
                    return before // 2
            if time.monotonic() > deadline:
                raise MailboxError(
                    f"'{name}' must be complete within {timeout_s:g} s, got "
                    f"none after version {before // 2}"
                )
            time.sleep(1e-4)

    def _matching(self, name: str, module: Weights) -> Mapping[str, Tensor]:
        if name not in self._slots:
            known = ", ".join(self.names)
            raise MailboxError(f"name must be one of {known}, got '{name}'")
        tensors = tensors_of(module)
        held = {key: list(slot.shape) for key, slot in self._slots[name].items()}
        given = {key: list(value.shape) for key, value in tensors.items()}
        for key in held | given:
            shape, other = held.get(key, "nothing"), given.get(key, "nothing")
            if shape != other:
                raise MailboxError(f"{key} in '{name}' must be {shape}, got {other}")
        return tensors


def tensors_of(module: Weights) -> dict[str, Tensor]:
    """Parameters and persistent buffers by name: the module's own memory, detached."""
    entries = module.state_dict() if isinstance(module, nn.Module) else module
    return {name: value for name, value in entries.items() if isinstance(value, Tensor)}
