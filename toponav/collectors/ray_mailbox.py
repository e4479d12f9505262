"""`RayMailbox`: weights in Ray's object store, for collectors on other machines."""

from collections.abc import Mapping
from typing import Any

import torch

from toponav.collectors.mailbox import (
    Shapes,
    Weights,
    shapes_of,
    tensors_of,
    tensors_that_fit,
)

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError:  # the settings are refused before anything here is used
    ray = None


class RayMailbox:
    """`Mailbox` for processes of a Ray cluster: the same methods, any machine.

    Weights lie in Ray's object store, where each machine fetches a version once for all
    of its processes. A small actor beside the publisher says which is the newest;
    copies of the mailbox in other processes ask it.

    TorchRL's ``RayWeightSyncScheme`` is not used: it joins learner and workers in one
    process group whose size is fixed when it begins, so that a replacement of a worker
    that died cannot join, and its learner waits for each worker to take the weights.

    Args:
        modules: what is published, by name.
        versions: number of these first values by name, 0 unless given.
    """

    def __init__(
        self,
        modules: Mapping[str, Weights],
        *,
        versions: Mapping[str, int] | None = None,
    ) -> None:
        self.names = tuple(modules)
        self._shapes: dict[str, Shapes] = {
            name: shapes_of(tensors_of(module)) for name, module in modules.items()
        }
        # Beside the publisher: a machine that dies must not take it along.
        here = ray.get_runtime_context().get_node_id()
        place = NodeAffinitySchedulingStrategy(here, soft=False)
        remote = ray.remote(num_cpus=0, scheduling_strategy=place)
        self._board = remote(_board_class()).remote()
        for name, module in modules.items():
            self._post(name, (versions or {}).get(name, 0), module)

    def version(self, name: str) -> int:
        """Number of the newest publication."""
        return int(ray.get(self._board.version.remote(name)))

    def publish(self, name: str, module: Weights) -> int:
        """Publish new weights of the module ``name``; returns their version."""
        version = self.version(name) + 1
        self._post(name, version, module)
        return version

    def pull(self, name: str, module: Weights) -> int:
        """Copy the newest weights into a module on any device; returns their version.

        `MailboxError` if the module does not fit.
        """
        target = tensors_that_fit(self._shapes, name, module)
        version, (reference,) = ray.get(self._board.read.remote(name))
        with torch.no_grad():
            for key, value in ray.get(reference).items():
                target[key].copy_(value)
        return int(version)

    def _post(self, name: str, version: int, module: Weights) -> None:
        found = tensors_that_fit(self._shapes, name, module)
        tensors = {key: value.cpu() for key, value in found.items()}
        # In a list, or Ray would hand over the weights, not where they are. Waiting for
        # the answer makes sure that whoever asks from now on gets them.
        reference = [ray.put(tensors)]
        ray.get(self._board.post.remote(name, version, reference))


def _board_class() -> type:
    # Made here, Ray sends its code: an actor of a module's class would import torch.
    class Board:
        """Remembers where the newest weights of each name are."""

        def __init__(self) -> None:
            self.newest: dict[str, tuple[int, list[Any]]] = {}

        def post(self, name: str, version: int, reference: list[Any]) -> None:
            self.newest[name] = version, reference

        def version(self, name: str) -> int:
            return self.newest[name][0]

        def read(self, name: str) -> tuple[int, list[Any]]:
            return self.newest[name]

    return Board
