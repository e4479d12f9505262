"""One engine: a thin, safe shell around ``DoomGame``.

All console commands start scripts with negative numbers: the engine drops a second
start of a running script in the same tic unless the number is negative.
"""

import ctypes
import math
import os
import signal
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toponav.envs.engines.doom import instances
from toponav.envs.engines.doom.hang_watch import (
    forget_calls,
    kill_engine,
    start_watch,
    waiting_for,
)
from toponav.envs.engines.doom.level import check_wad
from toponav.envs.engines.doom.spec import TICS_PER_DECISION, WORLD
from toponav.envs.game import EngineError, EngineLostError

try:
    import vizdoom
except ImportError as error:  # the first start says what to do
    vizdoom = None  # type: ignore[assignment]
    _import_error = str(error)

# The player cannot move during the first tics of a level.
_FROZEN_TICS = 10
_FIXED_POINT = 65536
# A start takes 0.2 s of a processor. One that uses none for so long has stopped; where
# others take nearly all of it, one of the lowest priority takes minutes.
_IDLE_SECONDS = 120.0
# An engine whose process is not seen for so long is not going to start.
_SECONDS_WITHOUT_PROCESS = 5.0
_REMEDY = (
    "pip has wheels of 'vizdoom' for Linux (x86-64 and ARM with glibc), macOS on "
    "Apple silicon and Windows on x86-64, for Python 3.10 to 3.14; elsewhere build "
    "it from source (https://vizdoom.farama.org) or use one of these systems"
)
_first_start = threading.Lock()
# Two forks at once can hang: before each, OpenBLAS (in SciPy and NumPy) ends its own
# threads, and of two that wait for the same thread to end one may never return.
_forking = threading.Lock()


class Engine:
    """Runs one map of one WAD in a process of its own, without a window.

    An ``EngineError`` if it is not installed or cannot load the map; tests ``inspect``
    its own depth and its list of all things.
    """

    def __init__(self, wad: Path, map_name: str, *, inspect: bool = False) -> None:
        self._wad = wad
        self._map_name = map_name
        self._inspect = inspect
        self._game: vizdoom.DoomGame | None = None
        self._start()

    def _start(self) -> None:
        if vizdoom is None:
            raise EngineError(
                "the ViZDoom engine must be installed, and it is not "
                f"({_import_error}): {_REMEDY}"
            )
        with _first_start:  # one probe, however many engines start at once
            instances.sweep_if_due()
            check_wad(self._wad, self._map_name)
        instances.end_engines_on_sigterm()
        self._folder = instances.claim()
        self._end = weakref.finalize(self, instances.release, self._folder)
        game = _configure(self._wad, self._map_name, self._folder)
        game.set_depth_buffer_enabled(self._inspect)
        game.set_objects_info_enabled(self._inspect)
        try:
            _init(game, self._folder)
        except EngineError:
            self._end()
            raise
        instances.note_instance(self._folder, game.get_instance_id())
        start_watch()
        self._game = game
        _running.add(self)

    @property
    def game(self) -> "vizdoom.DoomGame":
        """The running engine; an ``EngineError`` if it was closed."""
        if self._game is None:
            raise EngineError("the engine must be running, and it was closed")
        return self._game

    def restart(self) -> None:
        """Start again, also after the engine's process died."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the engine and remove its files."""
        game, self._game = self._game, None
        if game is not None:
            # For one that hangs ViZDoom would wait, and let no other thread run.
            kill_engine(self._folder)
            game.close()
        self._end()

    # All of the following raise EngineLostError if the engine died, or hung for so long
    # that it was ended.

    def new_episode(self) -> None:
        """Reload the map, so that nothing of the last episode is left."""
        with _noticing_losses(self._folder):
            self.game.new_episode()

    def run_script(self, script: int, *arguments: int) -> None:
        """Ask for a script; it runs at the start of the next tic."""
        words = " ".join(str(argument) for argument in arguments)
        with _noticing_losses(self._folder):
            self.game.send_game_command(f"puke -{script} {words}")

    def act(self, buttons: Sequence[float], tics: int = TICS_PER_DECISION) -> None:
        """Hold buttons for some tics: forward, backward, degrees a tic to the right."""
        with _noticing_losses(self._folder):
            self.game.make_action(buttons, tics)

    def observe(self) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """The view, uint8 ``[H, W, 3]``, and x, y, angle, apples, goals touched."""
        with _noticing_losses(self._folder):
            state = self.game.get_state()
        if state is None or state.screen_buffer is None or state.game_variables is None:
            raise EngineLostError("the engine must show a view, and it has none")
        return state.screen_buffer, state.game_variables

    @property
    def pid(self) -> int:
        """Process number of the engine."""
        pid = instances.engine_pid(self._folder)
        if pid is None:
            raise EngineLostError("the engine must be running, and it has no process")
        return pid

    def abandon(self) -> None:
        """In a forked child: leave the parent's engine alone."""
        game, self._game = self._game, None
        self._end.detach()
        if game is not None:
            # Destroying it would wait for a thread that a fork does not copy.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(game))


def fixed(value: float) -> int:
    """A map coordinate as the 16.16 fixed-point number that scripts take."""
    return round(value * _FIXED_POINT)


def turn(degrees: float) -> int:
    """Degrees as the 65536ths of a turn that scripts take."""
    return round(degrees / 360.0 * _FIXED_POINT) % _FIXED_POINT


# Those that a fork would copy.
_running: "weakref.WeakSet[Engine]" = weakref.WeakSet()


def _abandon_parents_engines() -> None:
    global _first_start, _forking
    _first_start, _forking = threading.Lock(), threading.Lock()
    forget_calls()
    for engine in list(_running):
        engine.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_parents_engines)


@contextmanager
def _noticing_losses(folder: Path) -> Iterator[None]:
    try:
        with waiting_for(folder):
            yield
    except (
        vizdoom.ViZDoomErrorException,
        vizdoom.ViZDoomUnexpectedExitException,
        vizdoom.ViZDoomIsNotRunningException,
    ) as error:
        raise EngineLostError(f"the engine died: {error}") from error


def _init(game: "vizdoom.DoomGame", folder: Path) -> None:
    # In a thread: the engine's own ``init`` never returns if its process dies.
    failures: list[Exception] = []

    def init() -> None:
        _keep_from_signals()
        try:
            game.init()
        except Exception as error:
            failures.append(error)

    def has_begun() -> bool:
        deadline = time.monotonic() + _SECONDS_WITHOUT_PROCESS
        while starter.is_alive() and instances.engine_pid(folder) is None:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True

    starter = threading.Thread(target=init, daemon=True, name="engine-start")
    instances.note_starter(folder, starter)
    with _forking:
        starter.start()
        found = has_begun()
    worked, deadline = -math.inf, math.inf
    while found and starter.is_alive() and time.monotonic() < deadline:
        if (now := instances.seconds_worked(folder)) > worked:
            worked, deadline = now, time.monotonic() + _IDLE_SECONDS
        starter.join(1.0)
        found = has_begun()
    if starter.is_alive():
        given = f"did nothing for {_IDLE_SECONDS:g} s" if found else "has no process"
        raise EngineError(
            f"the engine must start, and it {given}: it was ended or stopped from "
            "outside, or the machine is overloaded"
        )
    if failures:
        raise EngineError(f"the engine must start, got: {failures[0]}")


def _keep_from_signals() -> None:
    """Block Ctrl-C and SIGTERM in this thread, and so in the engine that it starts.

    They may be sent to all of a process group. An engine that ends while it starts
    takes this process along, since ViZDoom then reads memory that it has not mapped
    yet; so it is left to the process that started it.
    """
    if hasattr(signal, "pthread_sigmask"):  # Windows has no masks
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})


def _configure(wad: Path, map_name: str, folder: Path) -> "vizdoom.DoomGame":
    height, width = WORLD.view_size
    game = vizdoom.DoomGame()
    game.set_doom_config_path(str(instances.ini_path(folder)))
    game.set_doom_scenario_path(str(wad))
    game.set_doom_map(map_name)
    game.set_mode(vizdoom.Mode.PLAYER)
    game.set_window_visible(False)
    game.set_sound_enabled(False)
    resolution = getattr(vizdoom.ScreenResolution, f"RES_{width}X{height}")
    game.set_screen_resolution(resolution)
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    for option in (
        *("hud", "crosshair", "weapon", "messages", "decals", "particles"),
        *("effects_sprites", "corpses", "screen_flashes"),
    ):
        getattr(game, f"set_render_{option}")(False)
    button, variable = vizdoom.Button, vizdoom.GameVariable
    walk = (button.MOVE_FORWARD, button.MOVE_BACKWARD)
    game.set_available_buttons([*walk, button.TURN_LEFT_RIGHT_DELTA])
    pose = (variable.POSITION_X, variable.POSITION_Y, variable.ANGLE)
    game.set_available_game_variables([*pose, variable.USER1, variable.USER2])
    game.set_episode_start_time(_FROZEN_TICS)
    game.set_episode_timeout(0)  # our own clock ends episodes
    game.add_game_args("+movebob 0")
    return game
