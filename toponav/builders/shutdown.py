"""`stop_collector`: how every recipe ends its collecting processes."""

import torch
from torchrl.collectors import BaseCollector

from toponav.envs import end_stray_engines


def stop_collector(collector: BaseCollector) -> None:
    """Shut a collector down, whatever state its processes are in.

    TorchRL then gives this process their threads too, with which small operations take
    a hundred times as long on a busy machine; it keeps its own number here. Engines of
    a process that was killed are ended.
    """
    threads = torch.get_num_threads()
    collector.shutdown(raise_on_error=False)
    torch.set_num_threads(threads)
    end_stray_engines()
