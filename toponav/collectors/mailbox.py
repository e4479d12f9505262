"""`Mailbox`: weights in shared memory, and the collectors that read them from it."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only
from torchrl.collectors import Collector, MultiAsyncCollector

from toponav.collectors.patience import Patience
from toponav.keys import ENV_ID

#: What is published: a module (parameters and persistent buffers), or tensors by name.
Weights = nn.Module | Mapping[str, Tensor]
#: Shapes of tensors by name.
Shapes = dict[str, list[int]]

# The stamp is odd while a publication is being written.
_WRITING = 1
_HERE = torch.device("cpu")


class MailboxError(RuntimeError):
    """A mailbox cannot be read, or its tensors do not fit the given module."""


class Mailbox:
    """Weights of several modules in shared memory, a version number with each.

    One process publishes under a name; any number of others pull, each when it likes.
    TorchRL's own shared memory applies updates whenever they arrive, even in the middle
    of a rollout. Give the mailbox to other processes with their arguments: a copy by
    ``cloudpickle``, such as of a closure, receives nothing.

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

        MailboxError if the module does not fit, or none is complete in ``timeout_s`` of
        waiting.
        """
        target = self._matching(name, module)
        stamp, patience = self._stamps[name], Patience(timeout_s)
        while True:
            before = int(stamp)
            if not before & _WRITING:
                with torch.no_grad():
                    for key, slot in self._slots[name].items():
                        target[key].copy_(slot)
                if int(stamp) == before:
                    return before // 2
            if patience.is_over():
                raise MailboxError(
                    f"'{name}' must be complete within {timeout_s:g} s, got "
                    f"none after version {before // 2}"
                )
            time.sleep(1e-4)

    def _matching(self, name: str, module: Weights) -> Mapping[str, Tensor]:
        held = {key: shapes_of(slot) for key, slot in self._slots.items()}
        return tensors_that_fit(held, name, module)


def tensors_of(module: Weights) -> dict[str, Tensor]:
    """Parameters and persistent buffers by name: the module's own memory, detached."""
    entries = module.state_dict() if isinstance(module, nn.Module) else module
    return {name: value for name, value in entries.items() if isinstance(value, Tensor)}


def shapes_of(weights: Mapping[str, Tensor]) -> Shapes:
    """The shapes of tensors by their names."""
    return {key: list(value.shape) for key, value in weights.items()}


def tensors_that_fit(
    held: Mapping[str, Shapes], name: str, module: Weights
) -> Mapping[str, Tensor]:
    """The tensors of a module, of the shapes that are held under its name.

    Raises:
        MailboxError: if there is no such name, or a shape differs.
    """
    if name not in held:
        raise MailboxError(f"name must be one of {', '.join(held)}, got '{name}'")
    tensors = tensors_of(module)
    given = shapes_of(tensors)
    for key in held[name] | given:
        shape, other = held[name].get(key, "nothing"), given.get(key, "nothing")
        if shape != other:
            raise MailboxError(f"{key} in '{name}' must be {shape}, got {other}")
    return tensors


@dataclass(frozen=True)
class Subscription:
    """What a collector reads from a mailbox, and for which of its modules."""

    name: str
    #: Of the version in a batch, int64 ``[*B, T, 1]``.
    version_key: NestedKey
    #: Returns the module that gets the weights.
    find: Callable[[Collector], nn.Module]
    #: Called when a new version came, to compute stored embeddings again.
    refresh: Callable[[Collector], None] | None = None


class MailboxCollector(Collector):
    """Collects with the weights that a `Mailbox` held when the rollout began.

    Every batch ``[*B, T]`` is made by one version of each module and says by which. It
    is on the processor, wherever environments and policy are.
    Give it as ``collector_class`` to TorchRL's multi-process collectors, with their own
    way of sharing switched off: ``weight_sync_schemes={"policy":
    NoWeightSyncScheme()}``.

    Args:
        create_env_fn, policy, kwargs: as for TorchRL's ``Collector``.
        mailbox, subscriptions: what is read before every rollout.
        versions: of modules that were filled before the environments were built; a
            newer one is refreshed for. Those of the others are read without.
        keep: keys of a batch that leave this process, nested ones too; all by default.
        worker_idx: number of this collector among several, for ``env_id``.
    """

    def __init__(
        self,
        create_env_fn: Any,
        policy: Any = None,
        *,
        mailbox: Mailbox,
        subscriptions: Sequence[Subscription],
        versions: Mapping[str, int] | None = None,
        keep: Sequence[NestedKey] | None = None,
        worker_idx: int | None = None,
        **kwargs: Any,
    ) -> None:
        self.mailbox = mailbox
        self.subscriptions = tuple(subscriptions)
        self.versions = dict(versions or {})
        self.keep = keep
        self._batch: TensorDictBase | None = None
        super().__init__(create_env_fn, policy, worker_idx=worker_idx, **kwargs)
        # TorchRL sets it only for some ways of sharing weights.
        self.first_env_id = (worker_idx or 0) * max(self.env.batch_size.numel(), 1)

    def pull(self) -> None:
        """Read what was published since the last time."""
        for one in self.subscriptions:
            known = self.versions.get(one.name)
            if known == self.mailbox.version(one.name):
                continue
            self.versions[one.name] = self.mailbox.pull(one.name, one.find(self))
            if one.refresh is not None and known is not None:
                one.refresh(self)

    def rollout(self) -> TensorDictBase:
        """Read the weights, then collect a batch; TorchRL's buffers are used again."""
        self.pull()
        collected = super().rollout()
        if self._batch is None or not self._use_buffers:
            self._batch = self._make_batch(collected)
        elif not self._is_here:
            self._batch.update_(self._kept(collected))
        for one in self.subscriptions:
            self._batch.get(one.version_key).fill_(self.versions[one.name])
        return self._batch

    def running_episodes(self) -> dict[str, Any] | None:
        """What `resume_episodes` needs, between batches; ``None`` if it is unknown."""
        games, transform = getattr(self.env.base_env, "games", None), self.env.transform
        if games is None:
            return None
        weights = dict(transform.named_parameters())
        kept = {k: v for k, v in transform.state_dict().items() if k not in weights}
        state = {
            "games": games.running_episodes(),
            "transforms": kept,
            "carried": self._carrier.to_dict(),
            "next_trajectory": self._traj_pool.state_dict()["traj_id"],
            "versions": dict(self.versions),
            "generator": torch.get_rng_state(),
        }
        if (device := self.env.device).type == "cuda":
            state["cuda_generator"] = torch.cuda.get_rng_state(device)
        # It goes to another process, which may have another device.
        return tree_map_only(Tensor, Tensor.cpu, state)  # type: ignore[no-any-return]

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        """Continue from what an identical collector's `running_episodes` returned."""
        self.env.base_env.games.resume_episodes(state["games"])
        self.env.transform.load_state_dict(state["transforms"], strict=False)
        # All is read again: the transforms' state has buffers of what is published.
        self.versions = {}
        self.pull()
        self._carrier = self._carrier.empty().update(state["carried"])  # type: ignore[has-type]
        self._traj_pool.load_state_dict({"traj_id": state["next_trajectory"]})
        for one in self.subscriptions:
            if one.refresh and self.versions[one.name] != state["versions"][one.name]:
                one.refresh(self)
        torch.set_rng_state(state["generator"])
        if (device := self.env.device).type == "cuda" and "cuda_generator" in state:
            torch.cuda.set_rng_state(state["cuda_generator"], device)

    def _make_batch(self, collected: TensorDictBase) -> TensorDictBase:
        shape = collected.batch_size
        batch = self._kept(collected)
        if not self._is_here:
            batch = batch.cpu()
        numbers = torch.arange(max(shape[:-1].numel(), 1)).reshape(*shape[:-1], 1, 1)
        numbers = self.first_env_id + numbers.expand(*shape, 1)
        batch.set(ENV_ID, numbers.contiguous())
        for one in self.subscriptions:
            batch.set(one.version_key, torch.zeros(*shape, 1, dtype=torch.int64))
        return batch

    def _kept(self, collected: TensorDictBase) -> TensorDictBase:
        return collected.select(*self.keep) if self.keep else collected.copy()

    @property
    def _is_here(self) -> bool:
        """Whether rollouts are in this process's own memory, not in a device's."""
        return bool(self.env.device == _HERE)


class PatientAsyncCollector(MultiAsyncCollector):
    """TorchRL's ``MultiAsyncCollector`` with room for one batch of every process.

    TorchRL's own has room for one batch in all: a process that finds it taken twice
    drops its rollout, and its episodes get gaps.
    """

    #: Number of the process that made the last batch.
    maker: int | None = None

    def _get_from_queue(self, timeout: float | None = None) -> tuple[int, int, Any]:
        self.maker, number, batch = super()._get_from_queue(timeout)
        return self.maker, number, batch

    @property
    def _queue_len(self) -> int:
        return int(self.num_workers)
