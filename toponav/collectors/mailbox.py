"""`Mailbox`: weights in shared memory, left by one process and fetched by others."""

import time
from collections.abc import Mapping

import torch
from tensordict import TensorDict
from torch import Tensor, nn

# The stamp is odd while a publication is being written.
_WRITING = 1


class MailboxError(RuntimeError):
    """What is in a mailbox cannot be read, or does not fit the reader's module."""


class Mailbox:
    """Weights of several modules in shared memory, a version number with each.

    One process publishes; any number of others pull, each when it likes, and nobody
    waits for anybody. This is A3C's way of sharing: a worker copies the global
    parameters before a rollout and leaves them alone until its end. TorchRL's own
    schemes for shared memory apply updates whenever they arrive, so that one rollout
    may hold decisions of several versions.

    Give the mailbox to other processes with their arguments (``Process`` or
    TorchRL's collectors): it keeps its memory on the way. A copy by
    ``cloudpickle``, such as of a closure, has memory of its own and hears nothing.

    A reader never gets half of one publication and half of another: the stamp is odd
    while a writer writes, and a copy during which it changed is made again. One
    process publishes under a name; two at a time would spoil that.

    Args:
        modules: what is published, by name: a module, of which parameters and
            persistent buffers go into the mailbox, or tensors by name.
        versions: number of these first values by name, 0 unless given.

    Examples:
        >>> here, there = nn.Linear(2, 2), nn.Linear(2, 2)
        >>> mailbox = Mailbox({"policy": here})
        >>> mailbox.publish("policy", here), mailbox.pull("policy", there)
        (1, 1)
        >>> bool((here.weight == there.weight).all())
        True
    """

    def __init__(
        self,
        modules: Mapping[str, nn.Module | Mapping[str, Tensor]],
        *,
        versions: Mapping[str, int] | None = None,
    ) -> None:
        self._slots: dict[str, TensorDict] = {}
        self._stamps: dict[str, Tensor] = {}
        for name, module in modules.items():
            tensors = {key: value.cpu() for key, value in tensors_of(module).items()}
            self._slots[name] = TensorDict(tensors).clone().share_memory_()
            stamp = torch.tensor(2 * (versions or {}).get(name, 0))
            self._stamps[name] = stamp.share_memory_()

    @property
    def names(self) -> tuple[str, ...]:
        """What there are publications of."""
        return tuple(self._slots)

    def version(self, name: str) -> int:
        """Number of the newest publication that is complete."""
        return int(self._stamps[name]) // 2

    def publish(self, name: str, module: nn.Module | Mapping[str, Tensor]) -> int:
        """Leave new weights for the readers.

        Args:
            name: under which they are published.
            module: as given at the start, with other values.

        Returns:
            Their version, one more than the last.

        Raises:
            MailboxError: if the module does not fit what was given at the start.
        """
        source = self._matching(name, module)
        stamp = self._stamps[name]
        stamp |= _WRITING
        for key, slot in self._slots[name].items():
            slot.copy_(source[key])
        stamp += 1
        return int(stamp) // 2

    def pull(
        self,
        name: str,
        module: nn.Module | Mapping[str, Tensor],
        *,
        timeout_s: float = 60.0,
    ) -> int:
        """Copy the newest weights into a module, in place.

        Args:
            name: under which they are published.
            module: gets the values; on any device.
            timeout_s: seconds to wait while a publication is being written.

        Returns:
            Their version.

        Raises:
            MailboxError: if the module does not fit, or if no whole publication was
                to be had in time, as when the publisher died while it wrote.
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
                    f"'{name}' must be published whole within {timeout_s:g} s, got "
                    f"none after version {before // 2}"
                )
            time.sleep(1e-4)

    def _matching(
        self, name: str, module: nn.Module | Mapping[str, Tensor]
    ) -> Mapping[str, Tensor]:
        """The module's tensors, if they are those of the mailbox."""
        if name not in self._slots:
            known = ", ".join(self._slots)
            raise MailboxError(f"name must be one of {known}, got '{name}'")
        tensors, slots = tensors_of(module), self._slots[name]
        for key, slot in slots.items():
            given = tensors.get(key)
            if given is None or given.shape != slot.shape:
                shape = "nothing" if given is None else list(given.shape)
                raise MailboxError(
                    f"'{name}' must hold {key} of shape {list(slot.shape)}, got {shape}"
                )
        if extra := set(tensors) - set(slots.keys()):
            raise MailboxError(
                f"'{name}' must hold what it held at the start, got {min(extra)} too"
            )
        return tensors


def tensors_of(module: nn.Module | Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """Parameters and persistent buffers by name: the module's own memory, detached."""
    if not isinstance(module, nn.Module):
        return module
    return {
        name: value
        for name, value in module.state_dict().items()
        if isinstance(value, Tensor)
    }
