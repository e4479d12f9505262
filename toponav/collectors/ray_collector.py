"""`LastingRayCollector`: TorchRL's collector on a Ray cluster, which outlives nodes."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.collectors.distributed import RayCollector
from tqdm import tqdm

from toponav.collectors.patience import Patience
from toponav.collectors.prepared_collector import PreparedCollector
from toponav.keys import TRAJECTORY

try:
    import ray
    from ray.exceptions import RayActorError, RayError, RayTaskError
except ImportError:  # the settings are refused before anything here is used
    ray = None

# What a worker takes of its machine; they are spread over the machines.
_WORKER = {"num_cpus": 1, "scheduling_strategy": "SPREAD"}
# A worker that dies so often without a batch in between does it by itself.
_MOST_DEATHS = 3
# Seconds after which who waits for workers asks whether it has waited too long.
_ASK_EVERY_S = 1.0
# Seconds in which workers close their environments before they are killed.
_CLOSE_S = 10.0
# Seconds in which what a worker has made must come; what a dead machine made does not.
_FETCH_S = 30.0
# Room for the trajectories of one worker before their numbers are another one's.
_TRAJECTORIES = 2**32


class LastingRayCollector(RayCollector):
    """TorchRL's ``RayCollector`` of `PreparedCollector`, whose workers may die.

    TorchRL's own ends with the first call that fails. Here the decisions of a worker
    that died are lost, one sentence says so, and a new one takes its number and its
    environments as soon as Ray finds room for it, while the others go on. Without
    ``sync`` a worker begins its next batch when the caller takes the last one, as in
    ``MultiAsyncCollector``: one more call waiting for it would save the time that a
    batch is on its way, with weights that are a batch older. Trajectories are numbered
    through over all workers, as they are by TorchRL's collectors on one machine.

    Args:
        max_idle_s: seconds without a batch, or to start in, before ``TimeoutError``.
        create_env_fn, collector_kwargs: as for ``RayCollector``, one for each worker.
        arguments: more of those of ``RayCollector``.
    """

    def __init__(
        self,
        create_env_fn: list[Any],
        *,
        max_idle_s: float,
        collector_kwargs: list[dict[str, Any]],
        **arguments: Any,
    ) -> None:
        self.max_idle_s = max_idle_s
        self._create_env_fn = create_env_fn
        # Calls without an answer yet, and starts that go on, with the worker of each.
        self._calls: dict[Any, int] = {}
        self._starting: dict[Any, int] = {}
        # How often each worker was started again, and how often since its last batch.
        self._starts = dict.fromkeys(range(len(create_env_fn)), 0)
        self._deaths = dict(self._starts)
        # Number of the first trajectory of each, and how many have been given one.
        self._first = {worker: worker * _TRAJECTORIES for worker in self._starts}
        self._num_started = len(self._starts)
        with warnings.catch_warnings():
            # It misses the weights of a policy, which the mailbox brings.
            warnings.simplefilter("ignore", UserWarning)
            super().__init__(
                create_env_fn,
                collector_class=PreparedCollector,
                collector_kwargs=collector_kwargs,
                remote_configs=_WORKER,
                weight_sync_schemes={},
                **arguments,
            )

    def add_collectors(self, *arguments: Any) -> None:
        super().add_collectors(*arguments)
        # TorchRL would wait for them without an end, and say nothing of why.
        try:
            ready = [one.__ray_ready__.remote() for one in self.remote_collectors]
            for start in self._wait(ready, len(ready)):
                _answer(start)
        except BaseException:
            self.shutdown()
            raise

    def iterator(self) -> Iterator[TensorDictBase]:
        for worker in self._starts:
            self._call(worker)
        yield from self._collect_together() if self._sync else self._collect_apart()
        raise RuntimeError("none of them is left")

    def _collect_apart(self) -> Iterator[TensorDictBase]:
        """Batches of single workers, in the order in which they are done."""
        while self._calls or self._starting:
            (first,) = self._wait([*self._calls, *self._starting], 1)
            if first in self._starting:
                if (worker := self._begin(first)) is not None:
                    self._call(worker)
                continue
            worker = self._calls[first]
            if (batch := self._take(first)) is not None:
                self._call(worker)
                yield batch

    def _collect_together(self) -> Iterator[TensorDictBase]:
        """Batches of all workers that live, one after the other in their order."""
        while self._calls or self._starting:
            if self._calls:
                self._wait(list(self._calls), len(self._calls))
            else:
                self._wait(list(self._starting), 1)
            calls = sorted(self._calls.items(), key=lambda one: one[1])
            batches = {worker: self._take(call) for call, worker in calls}
            made = {w: batch for w, batch in batches.items() if batch is not None}
            if made:
                yield torch.cat(list(made.values()))
            # Only now, so that all begin with what the caller has just published.
            starts = list(self._starting)
            if starts:
                starts, _ = ray.wait(starts, num_returns=len(starts), timeout=0)
            begun = map(self._begin, starts)
            for worker in sorted([*made, *(one for one in begun if one is not None)]):
                self._call(worker)

    def _call(self, worker: int) -> None:
        """Ask a worker for a batch."""
        self._calls[self.remote_collectors[worker].next.remote()] = worker

    def _take(self, call: Any) -> TensorDictBase | None:
        """The batch that answers a call; ``None`` of a worker that died."""
        worker = self._calls.pop(call)
        try:
            batch = _answer(call)
        except RayError as error:
            self._replace(worker, error)
            return None
        self._deaths[worker] = 0
        if TRAJECTORY in batch.keys(include_nested=True):
            batch.set(TRAJECTORY, batch.get(TRAJECTORY) + self._first[worker])
        return batch

    def _begin(self, start: Any) -> int | None:
        """The worker that has started; ``None`` if it died before."""
        worker = self._starting.pop(start)
        try:
            _answer(start)
        except (RayError, RuntimeError) as error:
            self._replace(worker, error)
            return None
        return worker

    def _replace(self, worker: int, error: Exception) -> None:
        """Start a worker again, unless it dies again and again."""
        self._deaths[worker] += 1
        goes_on = self._deaths[worker] < _MOST_DEATHS
        reason = str(error).strip().splitlines()[0].partition(". ")[0]
        follows = "is started again when there is room" if goes_on else "is given up"
        sentence = f"a collecting process was lost with its decisions and {follows}"
        tqdm.write(f"{sentence} (number {worker}: {reason})", sys.stderr)
        with suppress(RayError):
            ray.kill(self.remote_collectors[worker])
        if not goes_on:
            return
        self._starts[worker] += 1
        self._first[worker] = self._num_started * _TRAJECTORIES
        self._num_started += 1
        arguments = {**self.collector_kwargs[worker], "episodes": None}
        actor = self._make_collector(
            self.collector_class.as_remote(_WORKER).remote,
            env_maker=self._create_env_fn[worker],
            policy=None,
            other_params={
                **arguments,
                "worker_idx": worker,
                "start": self._starts[worker],
            },
        )
        self._remote_collectors[worker] = actor
        self._starting[actor.__ray_ready__.remote()] = worker

    def _wait(self, references: list[Any], num: int) -> list[Any]:
        """The first ``num`` that are done; TimeoutError if they take too long."""
        patience = Patience(self.max_idle_s)
        done: list[Any] = []
        while len(done) < num:
            if patience.is_over():
                raise TimeoutError
            # Not until they are here: it would wait for what a dead machine has made,
            # which never comes, and not for what others make meanwhile.
            done, _ = ray.wait(
                references, num_returns=num, timeout=_ASK_EVERY_S, fetch_local=False
            )
        return done

    def shutdown(
        self, timeout: float | None = None, shutdown_ray: bool = True, **_: Any
    ) -> None:
        """End all workers, their environments first, and leave the cluster."""
        if not ray.is_initialized():
            return
        with suppress(RayError):
            for call in self._calls:
                ray.cancel(call)
            closing = [one.shutdown.remote() for one in self.remote_collectors]
            if closing:
                ray.wait(closing, num_returns=len(closing), timeout=_CLOSE_S)
        self._calls, self._starting = {}, {}
        super().shutdown(timeout, shutdown_ray)


def _answer(reference: Any) -> Any:
    """What a worker returned; what it raised, unless it died."""
    try:
        return ray.get(reference, timeout=_FETCH_S)
    except RayTaskError as error:
        cause = error.cause
        raise cause if isinstance(cause, Exception) else RuntimeError(cause) from error
    except RayActorError as error:
        if not error.actor_init_failed:
            raise
        # Ray hands over only the text of what was raised.
        raise RuntimeError(str(error).strip().splitlines()[-1]) from error
