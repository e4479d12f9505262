"""`MailboxCollector`: a TorchRL collector that fetches its weights from a mailbox."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.collectors import Collector

from toponav.collectors.mailbox import Mailbox
from toponav.keys import ENV_ID


@dataclass(frozen=True)
class Subscription:
    """What a collector fetches, for which module, and how it says which version.

    Args:
        name: under which the mailbox publishes it.
        version_key: key of the version in every batch, int64 ``[*B, T, 1]``.
        find: gives the module that gets the weights; the collector's ``env`` and
            ``policy`` exist by then.
        refresh: called after another version came, before the first decision with
            it: whoever keeps embeddings makes them anew here.
    """

    name: str
    version_key: NestedKey
    find: Callable[[Collector], nn.Module]
    refresh: Callable[[Collector], None] | None = None


class MailboxCollector(Collector):
    """Collects, with the weights that a `Mailbox` held when the rollout began.

    Every batch is made by one version of each module and says by which. It is the
    ``collector_class`` of a `PatientAsyncCollector` or ``MultiSyncCollector``, whose
    own way of sharing weights is then switched off::

        PatientAsyncCollector(
            [make_env] * 2,
            policy_factory=make_policy,
            weight_sync_schemes={"policy": NoWeightSyncScheme()},
            collector_class=partial(
                MailboxCollector, mailbox=mailbox, subscriptions=[...]
            ),
            ...
        )

    Args:
        create_env_fn: as for TorchRL's ``Collector``.
        policy: as for TorchRL's ``Collector``.
        mailbox: where the weights come from.
        subscriptions: what is fetched, all of it before every rollout.
        keep: keys of a batch that are handed over, ``("next", ...)`` ones included;
            all by default. What is left out never leaves this process.
        worker_idx: number of this collector among several; with the number of its
            environments it makes ``env_id``.
        kwargs: as for TorchRL's ``Collector``.

    Shape notation:
        B: environments of this collector.  T: decisions of a rollout.
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
        """Fetch what was published since the last time."""
        for one in self.subscriptions:
            known = self.versions.get(one.name)
            if known == self.mailbox.version(one.name):
                continue
            self.versions[one.name] = self.mailbox.pull(one.name, one.find(self))
            if one.refresh is not None and known is not None:
                one.refresh(self)

    def rollout(self) -> TensorDictBase:
        """Fetch the weights, then collect a batch with them.

        Returns:
            The batch ``[*B, T]``; the same tensordict, written anew, if TorchRL's
            buffers are in use.
        """
        self.pull()
        collected = super().rollout()
        if self._batch is None or not self._use_buffers:
            self._batch = self._hand_over(collected)
        for one in self.subscriptions:
            self._batch.get(one.version_key).fill_(self.versions[one.name])
        return self._batch

    def _hand_over(self, collected: TensorDictBase) -> TensorDictBase:
        """The kept keys, sharing memory with what was collected, and our own."""
        shape = collected.batch_size
        batch = collected.select(*self.keep) if self.keep else collected.copy()
        numbers = torch.arange(max(shape[:-1].numel(), 1)).reshape(*shape[:-1], 1, 1)
        numbers = self.first_env_id + numbers.expand(*shape, 1)
        batch.set(ENV_ID, numbers.contiguous())
        for one in self.subscriptions:
            batch.set(one.version_key, torch.zeros(*shape, 1, dtype=torch.int64))
        return batch
