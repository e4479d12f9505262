"""One engine: a thin, safe shell around ``DoomGame``.

All console commands start scripts with negative numbers: the engine drops a
second start of a running script in the same tic unless the number is negative.
"""

import ctypes
import os
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toponav.envs.doom import instances
from toponav.envs.doom.errors import EngineError, EngineLostError
from toponav.envs.doom.probe import check_wad, missing_engine

try:
    import vizdoom
except ImportError as error:  # the first start says what to do
    vizdoom = None  # type: ignore[assignment]
    _import_error = str(error)

#: Engine tics of one agent decision.
ACTION_REPEAT = 4
#: Height and width of the rendered view in pixels.
HEIGHT, WIDTH = 120, 160

# The player cannot move during the first tics of a level.
_FROZEN_TICS = 10
_FIXED_POINT = 65536
# A start takes 0.2 s, or a few seconds when dozens start at once.
_START_SECONDS = 120.0
# An engine whose process is not seen for so long is not going to start.
_SECONDS_WITHOUT_PROCESS = 5.0
_first_start = threading.Lock()
# How the engine says that its process died.
_FAILURES: tuple[type[Exception], ...] = ()
if vizdoom is not None:
    _FAILURES = (
        vizdoom.ViZDoomErrorException,
        vizdoom.ViZDoomUnexpectedExitException,
        vizdoom.ViZDoomIsNotRunningException,
    )


class Engine:
    """Runs one map of one WAD, without a window.

    The engine renders 160 x 120 RGB views and reports the player's pose. It is a
    process of its own and must be closed; ``close`` may be called twice.

    Args:
        wad: the compiled maze.
        map_name: its map's lump name.
        depth_buffer: also keep the engine's own depth picture (for tests: 8 bits,
            coarse, saturating).
        objects: also keep a list of all things in the map (for tests).

    Raises:
        EngineError: if the engine is not installed or cannot load the map.
    """

    def __init__(
        self,
        wad: Path,
        map_name: str,
        *,
        depth_buffer: bool = False,
        objects: bool = False,
    ) -> None:
        self._wad = wad
        self._map_name = map_name
        self._buffers = (depth_buffer, objects)
        self._game: vizdoom.DoomGame | None = None
        self._start()

    def _start(self) -> None:
        if vizdoom is None:
            raise missing_engine(_import_error)
        with _first_start:  # one probe, however many engines start at once
            instances.sweep()
            check_wad(self._wad, self._map_name)
        instances.end_engines_on_sigterm()
        self._folder = instances.claim()
        self._end = weakref.finalize(self, instances.release, self._folder)
        game = _configure(self._wad, self._map_name, self._folder, *self._buffers)
        try:
            _init(game, self._folder)
        except EngineError:
            self._end()
            raise
        instances.note_instance(self._folder, game.get_instance_id())
        self._game = game
        _running.add(self)

    @property
    def game(self) -> "vizdoom.DoomGame":
        """The running engine.

        Raises:
            EngineError: if it was closed.
        """
        if self._game is None:
            raise EngineError("the engine must be running, and it was closed")
        return self._game

    def restart(self) -> None:
        """Start anew, also after the engine's process died."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the engine and remove its files."""
        game, self._game = self._game, None
        if game is not None:
            game.close()
        self._end()

    def new_episode(self) -> None:
        """Reload the map, so that nothing of the last episode is left.

        Raises:
            EngineLostError: if the engine died.
        """
        try:
            self.game.new_episode()
        except _FAILURES as error:
            raise _lost(error) from error

    def run_script(self, script: int, *arguments: int) -> None:
        """Ask for a script; it runs at the start of the next tic.

        Raises:
            EngineLostError: if the engine died.
        """
        words = " ".join(str(argument) for argument in arguments)
        try:
            self.game.send_game_command(f"puke -{script} {words}")
        except _FAILURES as error:
            raise _lost(error) from error

    def act(self, buttons: Sequence[float], tics: int = ACTION_REPEAT) -> None:
        """Press buttons for some tics; the last one renders the view.

        Args:
            buttons: forward, backward (0 or 1), and degrees per tic to the right.
            tics: how long.

        Raises:
            EngineLostError: if the engine died.
        """
        try:
            self.game.make_action(buttons, tics)
        except _FAILURES as error:
            raise _lost(error) from error

    def observe(self) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """The view, uint8 ``[120, 160, 3]``, and the seven game variables.

        These are x, y (map units), angle (degrees, counter-clockwise from east),
        velocity in x and y (map units per tic), apples and goals touched in this
        episode.

        Raises:
            EngineLostError: if the engine died.
        """
        try:
            state = self.game.get_state()
        except _FAILURES as error:
            raise _lost(error) from error
        view, variables = (None, None)
        if state is not None:
            view, variables = state.screen_buffer, state.game_variables
        if view is None or variables is None:
            raise EngineLostError("the engine must show a view, and it has none")
        return view, variables

    @property
    def pid(self) -> int:
        """Process number of the engine.

        Raises:
            EngineLostError: if it has no process (any more).
        """
        pid = instances.engine_pid(self._folder)
        if pid is None:
            raise EngineLostError("the engine must be running, and it has no process")
        return pid

    def abandon(self) -> None:
        """In a forked child: leave the parent's engine alone for ever."""
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
    global _first_start
    _first_start = threading.Lock()
    for engine in list(_running):
        engine.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_parents_engines)


def _lost(error: Exception) -> EngineLostError:
    return EngineLostError(f"the engine died: {error}")


def _init(game: "vizdoom.DoomGame", folder: Path) -> None:
    """Start the engine; its own ``init`` never returns if its process dies."""
    failures: list[Exception] = []

    def init() -> None:
        try:
            game.init()
        except Exception as error:
            failures.append(error)

    starter = threading.Thread(target=init, daemon=True, name="engine-start")
    starter.start()
    begin = seen = time.monotonic()
    starter.join(1.0)
    while starter.is_alive():
        now = time.monotonic()
        if instances.engine_pid(folder) is not None:
            seen = now
        if now - begin > _START_SECONDS or now - seen > _SECONDS_WITHOUT_PROCESS:
            raise EngineError(
                f"the engine must start within {_START_SECONDS:g} s, and it did not: "
                "its process was ended from outside, or the machine is overloaded"
            )
        starter.join(1.0)
    if failures:
        raise EngineError(f"the engine must start, got: {failures[0]}")


def _configure(
    wad: Path, map_name: str, folder: Path, depth_buffer: bool, objects: bool
) -> "vizdoom.DoomGame":
    game = vizdoom.DoomGame()
    game.set_doom_config_path(str(instances.ini_path(folder)))
    game.set_doom_scenario_path(str(wad))
    game.set_doom_map(map_name)
    game.set_mode(vizdoom.Mode.PLAYER)
    game.set_window_visible(False)
    game.set_sound_enabled(False)
    game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    game.set_depth_buffer_enabled(depth_buffer)
    game.set_objects_info_enabled(objects)
    for option in (
        *("hud", "crosshair", "weapon", "messages", "decals", "particles"),
        *("effects_sprites", "corpses", "screen_flashes"),
    ):
        getattr(game, f"set_render_{option}")(False)
    game.set_available_buttons(
        [
            vizdoom.Button.MOVE_FORWARD,
            vizdoom.Button.MOVE_BACKWARD,
            vizdoom.Button.TURN_LEFT_RIGHT_DELTA,
        ]
    )
    variables = vizdoom.GameVariable
    game.set_available_game_variables(
        [
            *(variables.POSITION_X, variables.POSITION_Y, variables.ANGLE),
            *(variables.VELOCITY_X, variables.VELOCITY_Y),
            *(variables.USER1, variables.USER2),
        ]
    )
    game.set_episode_start_time(_FROZEN_TICS)
    game.set_episode_timeout(0)  # our own clock ends episodes
    game.add_game_args("+movebob 0")
    return game
