"""`Patience`: how long to wait for others, in time in which they could work."""

import time

# Who waits asks more often than this: a longer gap was none of waiting.
_LONGEST_GAP_S = 2.0


class Patience:
    """Is over after so many seconds of waiting; a pause counts as two of them at most.

    While a laptop sleeps or a job is suspended, those who are waited for do not work
    either. Ask it at least every second.

    Examples:
        >>> Patience(60.0).is_over()
        False
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._waited, self._before = 0.0, time.monotonic()

    def is_over(self) -> bool:
        """Whether all of it has been spent by now."""
        now = time.monotonic()
        self._waited += min(now - self._before, _LONGEST_GAP_S)
        self._before = now
        return self._waited > self.seconds
