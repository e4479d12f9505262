"""`PatientAsyncCollector`: no batch is lost while the caller is busy."""

from torchrl.collectors import MultiAsyncCollector


class PatientAsyncCollector(MultiAsyncCollector):
    """TorchRL's ``MultiAsyncCollector`` with room for one batch of every process.

    TorchRL's own has room for one batch in all. A process that finds it taken for a
    second drops what it collected and goes on, so that a caller who now and then takes
    longer (who draws a picture, or saves) gets episodes with holes. Between the views
    on either side of a hole lies no decision but a whole rollout, which networks that
    learn how far views are apart, and maps that join successive views, take for a step.
    Here each process waits with its batch until the caller takes it.

    Args:
        args, kwargs: as for ``MultiAsyncCollector``.

    Examples:
        As ``MultiAsyncCollector``::

            collector = PatientAsyncCollector(
                [make_env] * 2, policy, frames_per_batch=1000, total_frames=-1
            )
    """

    @property
    def _queue_len(self) -> int:
        return int(self.num_workers)
