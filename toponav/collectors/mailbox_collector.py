"""`MailboxCollector` reads weights from a mailbox; `PatientAsyncCollector` waits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.collectors import Collector, MultiAsyncCollector

from toponav.collectors.mailbox import Mailbox
from toponav.keys import ENV_ID


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

    Every batch ``[*B, T]`` is made by one version of each module and says by which.
    Give it as ``collector_class`` to TorchRL's multi-process collectors, with their own
    way of sharing switched off: ``weight_sync_schemes={"policy":
    NoWeightSyncScheme()}``.

    Args:
        create_env_fn, policy, kwargs: as for TorchRL's ``Collector``.
        mailbox, subscriptions: what is read before every rollout.
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
        keep: Sequence[NestedKey] | None = None,
        worker_idx: int | None = None,
        **kwargs: Any,
    ) -> None:
        self.mailbox = mailbox
        self.subscriptions = tuple(subscriptions)
        self.versions: dict[str, int] = {}
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
        for one in self.subscriptions:
            self._batch.get(one.version_key).fill_(self.versions[one.name])
        return self._batch

    def _make_batch(self, collected: TensorDictBase) -> TensorDictBase:
        shape = collected.batch_size
        batch = collected.select(*self.keep) if self.keep else collected.copy()
        numbers = torch.arange(max(shape[:-1].numel(), 1)).reshape(*shape[:-1], 1, 1)
        numbers = self.first_env_id + numbers.expand(*shape, 1)
        batch.set(ENV_ID, numbers.contiguous())
        for one in self.subscriptions:
            batch.set(one.version_key, torch.zeros(*shape, 1, dtype=torch.int64))
        return batch


class PatientAsyncCollector(MultiAsyncCollector):
    """TorchRL's ``MultiAsyncCollector`` with room for one batch of every process.

    TorchRL's own has room for one batch in all: a process that finds it taken twice
    drops its rollout, and its episodes get gaps. Here it waits until the caller takes
    its batch.
    """

    @property
    def _queue_len(self) -> int:
        return int(self.num_workers)
