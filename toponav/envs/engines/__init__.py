"""The engines behind the mazes, one room each."""

from importlib import import_module

from toponav.envs.game import GameEngine
from toponav.envs.mazes import unknown_name

#: Name of each engine -> its room, which holds a `GameEngine` as ``ENGINE``. Rooms must
#: import where the engine is not installed; the first start says what to install.
ENGINES = {
    "dmlab": "toponav.envs.engines.dmlab",
    "vizdoom": "toponav.envs.engines.doom",
}
#: The default engine of `MazeEnv`, and that of files that name none.
DEFAULT_ENGINE = "vizdoom"


def load_engine(name: str) -> GameEngine:
    """The engine of a name; the ``ValueError`` for another names the nearest."""
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    engine: GameEngine = import_module(ENGINES[name]).ENGINE
    return engine


def end_stray_engines() -> int:
    """End the engines of this user's killed processes; returns how many there were."""
    return sum(load_engine(name).end_strays() for name in ENGINES)
