"""`stop_requests`: Ctrl-C and SIGTERM wait until a batch is finished."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class StopRequest:
    """Whether Ctrl-C or SIGTERM asked a run to stop."""

    def __init__(self) -> None:
        #: Number of the signal, 0 without one.
        self.requested = 0

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the first one asks, the second one insists."""
        if self.requested:
            sys.exit(128 + number)
        self.requested = number


@contextmanager
def stop_requests() -> Iterator[StopRequest]:
    """Let a loop finish its batch before Ctrl-C or SIGTERM ends the process.

    In the block signals are only noted: look at ``requested`` between two batches. At
    its end a process that was asked to stop exits with the signal's status.
    """
    request = StopRequest()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, request) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if request.requested:
        print("stopped; resume=<run folder> continues", file=sys.stderr)  # noqa: T201
        sys.exit(128 + request.requested)
