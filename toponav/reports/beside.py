"""`Beside`: a function that a process of its own runs, beside this one."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Generic, NoReturn, TypeVar

from toponav.envs import end_stray_engines
from toponav.runs import IdleWatch

Result = TypeVar("Result")

#: Fewer decisions take less time than a process of their own needs to start: some six
#: seconds, in which a policy with two mazes makes 2,000, and blind ones 10,000.
FEW = 5_000
#: Seconds without any processor time after which the process hangs.
IDLE_S = 150.0
# What the process says.
_PROGRESS, _RESULT, _ERROR = "progress", "result", "error"
# Seconds that it gets to end its engines.
_WAIT_S = 20
# Low priority comes first, since loading torch takes seconds, and so does reading: the
# run waits for it. Modules are found where this process finds them.
_START = """
import os, pickle, sys
from multiprocessing.connection import Connection
os.nice(int(sys.argv[2]))
run = Connection(int(sys.argv[1]))
sys.path[:], work = pickle.loads(run.recv_bytes())
from toponav.reports.beside import work_beside
work_beside(run, work)
"""


class BesideError(RuntimeError):
    """A process beside the run did not end with a result; says why."""


class Beside(Generic[Result]):
    """A function that a process of its own runs, and its result.

    The process is started, not forked, and prints nothing. It ends with this object,
    and with this process, however that ends. Function, arguments and result must be
    what ``pickle`` can hold.

    Args:
        function: of a module's top level. It gets a callable, and then the
            ``arguments``; what it calls the callable with, plain values, ``heard`` is
            called with in a thread of this process.
        threads: of torch.
        nice: what is added to the priority of this process; 19 makes it the lowest.

    Raises:
        BesideError: if the arguments cannot be pickled.
    """

    def __init__(
        self,
        function: Callable[..., Result],
        *arguments: Any,
        heard: Callable[..., object] = lambda *_: None,
        threads: int = 1,
        nice: int = 0,
    ) -> None:
        try:
            work = pickle.dumps((function, arguments))
        except Exception as error:  # pickle raises many kinds
            raise BesideError(_sentence(error)) from error
        run, other = Pipe()
        with other:
            quiet = {"TQDM_DISABLE": "1", "OMP_NUM_THREADS": str(threads)}
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, str(other.fileno()), str(nice)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **quiet},
                pass_fds=[other.fileno()],
                # Ctrl-C is for the run, which ends it then. Not a session of its own:
                # Linux gives every session the same share of a core, whatever the
                # priorities in it.
                process_group=0,
            )
        self._future: Future[Result] = Future()
        # Neither this nor the thread knows the object, which may be freed meanwhile.
        self._end = weakref.finalize(self, _end, self.process)
        # One that dies at once is noticed when its result is needed.
        with suppress(OSError):
            run.send_bytes(pickle.dumps((sys.path, work)))
        known = run, self.process, heard, self._future
        threading.Thread(target=_listen, args=known, daemon=True).start()

    @property
    def is_running(self) -> bool:
        """Whether it has not said its result yet."""
        return not self._future.done()

    def result(self) -> Result:
        """Wait for the result.

        Raises:
            BesideError: with the reason of the process, or the status that it ended
                with if it said none; or if it takes no processor time any more.
        """
        watch = IdleWatch(self.process.pid, patience_s=IDLE_S)
        try:
            while True:
                # Of this wait: what the function raised is a `BesideError`.
                with suppress(TimeoutError):
                    return self._future.result(watch.look_s)
                if watch.is_idle():
                    self.process.kill()
                    raise BesideError(f"no processor time in {IDLE_S:g} s")
        finally:
            self.close()

    def close(self) -> None:
        """End the process and its engines, if it still runs."""
        self._end()


def work_beside(run: Connection, work: bytes) -> NoReturn:
    """The process that `Beside` starts: does the work and says how it ended."""
    # Engines do not get this copy, which they would keep open.
    os.set_inheritable(run.fileno(), False)

    def end_with_the_run() -> None:
        with suppress(EOFError, OSError):
            run.recv_bytes()  # nothing more is sent: it fails when the run ends
        os.kill(os.getpid(), signal.SIGTERM)

    def tell(*what: object) -> None:
        run.send_bytes(pickle.dumps((_PROGRESS, what)))

    threading.Thread(target=end_with_the_run, daemon=True).start()
    try:
        function, arguments = pickle.loads(work)
        said = pickle.dumps((_RESULT, function(tell, *arguments)))
    except Exception as error:
        said = pickle.dumps((_ERROR, _sentence(error)))
    with suppress(OSError):
        run.send_bytes(said)
    sys.exit(0)


def _listen(
    run: Connection,
    process: "subprocess.Popen[bytes]",
    heard: Callable[..., object],
    future: "Future[Any]",
) -> None:
    with run:
        try:
            while True:
                kind, said = pickle.loads(run.recv_bytes())
                if kind != _PROGRESS:
                    break
                heard(*said)
        except (EOFError, OSError):
            kind, said = _ERROR, f"exit status {process.wait()}"
        except Exception as error:
            kind, said = _ERROR, _sentence(error)
        if kind == _RESULT:
            future.set_result(said)
        else:
            future.set_exception(BesideError(said))
        # It ends by itself; once this end is closed, by a signal.
        process.wait()


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(_WAIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    # Those of a process that was killed, or that were just starting.
    if process.returncode:
        end_stray_engines()


def _sentence(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
