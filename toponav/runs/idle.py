"""`IdleWatch`: whether a process that is waited for has stopped working."""

from contextlib import suppress

import psutil

# Looks within the patience. This process takes none of them while it is stopped, too,
# as by Ctrl-Z, so that a pause of all is no sign.
_LOOKS = 12


class IdleWatch:
    """Watches the processor time of a process and its children.

    Ask `is_idle` every `look_s` seconds while waiting for it: where others take nearly
    all of a processor, a process that works still takes some of it within that time.

    Args:
        pid: of the process.
        patience_s: seconds without any processor time after which it is idle.

    Examples:
        >>> watch = IdleWatch(psutil.Process().pid, patience_s=60)
        >>> watch.look_s, watch.is_idle()
        (5.0, False)
    """

    def __init__(self, pid: int, *, patience_s: float) -> None:
        self.pid = pid
        #: Seconds between two looks.
        self.look_s = patience_s / _LOOKS
        self._seen: float | None = None
        self._looks = 0

    def is_idle(self) -> bool:
        """Look once; whether nothing was done in the last ``patience_s`` seconds."""
        worked = self._seconds_worked()
        self._looks = self._looks + 1 if worked == self._seen else 0
        self._seen = worked
        return self._looks >= _LOOKS

    def _seconds_worked(self) -> float:
        worked = 0.0
        with suppress(psutil.Error):
            process = psutil.Process(self.pid)
            for one in (process, *process.children(recursive=True)):
                with suppress(psutil.Error):
                    times = one.cpu_times()
                    worked += times.user + times.system
        return worked
