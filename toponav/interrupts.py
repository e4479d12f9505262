"""Ctrl-C and SIGTERM from the first import of a recipe to the end of its process."""

import _thread
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType, TracebackType

_NUMBERS = (signal.SIGINT, signal.SIGTERM)
#: Seconds after which fonts are surely listed.
_LISTING_S = 60.0
Handler = Callable[[int, FrameType | None], object]


def catch_early(name: str) -> None:
    """Answer signals from now on; a recipe's first statement.

    Until `catch_as_usual` the first Ctrl-C or SIGTERM ends the process: nothing has
    begun, and an exception might get lost in whatever is imported. Processes that a
    recipe spawns import it too; they leave Ctrl-C to the run, which ends them, and so
    do their engines, and end without a word if it was killed. Any other import of the
    recipe changes nothing.

    Args:
        name: the ``__name__`` of the recipe.
    """
    if name == "__mp_main__":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.excepthook = _say_unless_orphaned
    elif name == "__main__":
        _replace(signal.default_int_handler, _leave)
        signal.signal(signal.SIGTERM, _leave)
        _list_fonts()


def catch_as_usual() -> None:
    """Let Ctrl-C raise ``KeyboardInterrupt`` again, and SIGTERM ``SystemExit``.

    In a destructor or the callback of a weak reference Python prints an exception and
    goes on. A signal that lands there is sent once more, until it stops the run.
    """
    _replace(_leave, signal.default_int_handler)
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    sys.unraisablehook = _send_if_lost


def ignore_signals() -> None:
    """Let the process end in peace: its work is done, and Ctrl-C or SIGTERM is late.

    Python restores the handlers of the system before it frees its modules, but leaves
    alone what is ignored.
    """
    for number in _NUMBERS:
        signal.signal(number, signal.SIG_IGN)


def _replace(before: Handler, handler: Handler) -> None:
    # What a shell starts in the background ignores Ctrl-C, and stays so.
    if signal.getsignal(signal.SIGINT) is before:
        signal.signal(signal.SIGINT, handler)


def _leave(number: int, _frame: FrameType | None) -> None:
    if number == signal.SIGINT:
        sentence = f"{Path(sys.argv[0]).stem}: stopped by Ctrl-C\n"
        os.write(2, sentence.encode())  # standard error, without a lock or a buffer
    os._exit(128 + number)


def _list_fonts() -> None:
    """Let Matplotlib list a user's fonts, which it does once, without a break.

    A process that ended meanwhile would leave a lock, of which each later one complains
    after it has waited for five seconds. What a killed one left is removed.
    """
    import matplotlib

    folder = Path(matplotlib.get_cachedir())
    for lock in folder.glob("fontlist-*.matplotlib-lock"):
        with suppress(OSError):  # it has been removed meanwhile
            if time.time() - lock.stat().st_mtime > _LISTING_S:
                lock.unlink()
    if not any(folder.glob("fontlist-*.json")):
        caught = list[int]()
        before = {number: signal.getsignal(number) for number in _NUMBERS}
        for number in _NUMBERS:
            # Not masked: any other thread would take it.
            if before[number] is not signal.SIG_IGN:
                signal.signal(number, lambda number, _: caught.append(number))
        try:
            import matplotlib.font_manager
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        if caught:
            os.kill(os.getpid(), caught[0])


def _send_if_lost(lost: "sys.UnraisableHookArgs") -> None:
    error = lost.exc_value
    if isinstance(error, KeyboardInterrupt):
        number = int(signal.SIGINT)
    elif isinstance(error, SystemExit) and isinstance(error.code, int):
        number = error.code - 128
    else:
        sys.__unraisablehook__(lost)
        return
    # An exception would be lost here, too. This thread needs none of Python's locks,
    # which the main thread may hold.
    _thread.start_new_thread(_send, (number,))


def _send(number: int) -> None:
    time.sleep(0.05)
    os.kill(os.getpid(), number)


def _say_unless_orphaned(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    # Threads of multiprocessing answer a run that is killed meanwhile.
    run = multiprocessing.parent_process()
    if run is None or run.is_alive():
        sys.__excepthook__(kind, error, trace)
