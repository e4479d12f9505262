"""Load one map once and step one tic: ``python load_once.py WAD MAP INI``."""

import sys


def main(wad: str, map_name: str, ini: str) -> None:
    """Start the engine on a map, step one tic, end it."""
    # Here, because this module may be imported where the engine is missing.
    import vizdoom

    game = vizdoom.DoomGame()
    game.set_doom_config_path(ini)
    game.set_doom_scenario_path(wad)
    game.set_doom_map(map_name)
    game.set_window_visible(False)
    game.init()
    game.advance_action(1)
    game.close()


if __name__ == "__main__":
    main(*sys.argv[1:4])
