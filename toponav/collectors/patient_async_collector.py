"""`PatientAsyncCollector`: no batch is lost while the caller is busy."""

from torchrl.collectors import MultiAsyncCollector


class PatientAsyncCollector(MultiAsyncCollector):
    """TorchRL's ``MultiAsyncCollector`` with room for one batch of every process.

    TorchRL's own has room for one batch in all: a process that finds it taken twice
    drops its rollout, and its episodes get gaps. Here it waits until the caller takes
    its batch.
    """

    @property
    def _queue_len(self) -> int:
        return int(self.num_workers)
