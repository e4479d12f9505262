"""The maze's engine scripts, assembled to ACS bytecode.

The engine runs small scripts in its own byte code (ACS, the format of the "old"
``BEHAVIOR`` lump). The maze needs nine, too few to ask for a compiler. Python
starts them with the console command ``puke``; a negative number there means
"also while another run of the same script is under way".

Positions are 16.16 fixed point, angles 65536ths of a turn, counter-clockwise
from east. ACS global variable n is read in Python as ``GameVariable.USERn``.
"""

import struct
from collections.abc import Iterator

#: Script numbers, for ``puke``.
PLACE_PLAYER = 1
APPLE_TOUCHED = 2
GOAL_TOUCHED = 3
SET_RESPAWN = 4
SPAWN_APPLE = 5
REMOVE_THING = 6
CLOSE_SLOT = 7
OPEN_SLOT = 8
SPAWN_GOAL = 9

#: Thing tag of the goal; apples carry ``APPLE_TID + i``.
GOAL_TID = 99
APPLE_TID = 100

#: Height of a room in map units; a closed slot's floor is raised by as much.
ROOM_HEIGHT = 128

_STRINGS = ("MazeApple", "MazeGoal")

# Opcodes, with the numbers of arguments that follow in the code.
_TERMINATE = 1
_PUSH_NUMBER = 3
_LINE_SPECIAL = {1: 4, 2: 5, 3: 6, 4: 7, 5: 8}
_ASSIGN_MAP = 26
_PUSH_SCRIPT = 28
_PUSH_MAP = 29
_DROP = 54
_INC_GLOBAL = 188
_SET_ACTOR_ANGLE = 276
_SET_ACTOR_POSITION = 283
_CALL_FUNCTION = 351

_FUNCTION_SET_VELOCITY = 23
_FUNCTION_SPAWN_FORCED = 36

_SPECIAL_FLOOR_LOWER_INSTANT = 66
_SPECIAL_FLOOR_RAISE_INSTANT = 67
_SPECIAL_THING_REMOVE = 132

# Map variables: where the next respawn puts the player, and the goal's place.
_RESPAWN_X, _RESPAWN_Y, _RESPAWN_ANGLE, _GOAL_X, _GOAL_Y = range(5)

# An instruction pushes its operands, then acts on them.
_Code = list[int]


def _push(*values: int) -> _Code:
    return [word for value in values for word in (_PUSH_NUMBER, value)]


def _script_argument(index: int) -> _Code:
    return [_PUSH_SCRIPT, index]


def _map_variable(index: int) -> _Code:
    return [_PUSH_MAP, index]


def _move_player(x: _Code, y: _Code, angle: _Code) -> _Code:
    """Put the activator at a pose and stop it."""
    activator, ground, no_fog, replace = _push(0), _push(0), _push(0), _push(0, 0)
    return [
        *(*activator, *x, *y, *ground, *no_fog, _SET_ACTOR_POSITION, _DROP),
        *(*activator, *angle, _SET_ACTOR_ANGLE),
        *(*activator, *_push(0, 0, 0), *replace),
        *(_CALL_FUNCTION, 6, _FUNCTION_SET_VELOCITY, _DROP),
    ]


def _spawn(kind: int, x: _Code, y: _Code, tid: _Code) -> _Code:
    ground, east = _push(0), _push(0)
    return [
        *(*_push(kind), *x, *y, *ground, *tid, *east),
        *(_CALL_FUNCTION, 6, _FUNCTION_SPAWN_FORCED, _DROP),
    ]


def _special(number: int, *arguments: _Code) -> _Code:
    pushes = [word for argument in arguments for word in argument]
    return [*pushes, _LINE_SPECIAL[len(arguments)], number]


def _scripts() -> Iterator[tuple[int, int, _Code]]:
    """Number, argument count and code of each script."""
    first, second, third = (_script_argument(i) for i in range(3))
    goal_x, goal_y = _map_variable(_GOAL_X), _map_variable(_GOAL_Y)
    # The floor specials count heights in steps of eight map units.
    height = _push(ROOM_HEIGHT // 8)
    spawn_goal = _spawn(_STRINGS.index("MazeGoal"), goal_x, goal_y, _push(GOAL_TID))
    yield PLACE_PLAYER, 3, _move_player(first, second, third)
    yield APPLE_TOUCHED, 0, [_INC_GLOBAL, 1]
    respawn = _move_player(
        _map_variable(_RESPAWN_X),
        _map_variable(_RESPAWN_Y),
        _map_variable(_RESPAWN_ANGLE),
    )
    # The engine removes a thing that is picked up, so the goal is made anew.
    yield GOAL_TOUCHED, 0, [_INC_GLOBAL, 2, *respawn, *spawn_goal]
    yield (
        SET_RESPAWN,
        3,
        [
            *(*first, _ASSIGN_MAP, _RESPAWN_X),
            *(*second, _ASSIGN_MAP, _RESPAWN_Y),
            *(*third, _ASSIGN_MAP, _RESPAWN_ANGLE),
        ],
    )
    yield SPAWN_APPLE, 3, _spawn(_STRINGS.index("MazeApple"), first, second, third)
    yield REMOVE_THING, 1, _special(_SPECIAL_THING_REMOVE, first)
    yield CLOSE_SLOT, 1, _special(_SPECIAL_FLOOR_RAISE_INSTANT, first, _push(0), height)
    yield OPEN_SLOT, 1, _special(_SPECIAL_FLOOR_LOWER_INSTANT, first, _push(0), height)
    yield (
        SPAWN_GOAL,
        2,
        [
            *(*first, _ASSIGN_MAP, _GOAL_X),
            *(*second, _ASSIGN_MAP, _GOAL_Y),
            *spawn_goal,
        ],
    )


def behavior() -> bytes:
    r"""The ``BEHAVIOR`` lump: header, code, script directory, string table.

    Returns:
        The lump's bytes; always the same.

    Examples:
        >>> behavior()[:4], len(behavior()) < 2000
        (b'ACS\x00', True)
    """
    header_size = 8
    code, directory = b"", b""
    scripts = list(_scripts())
    for number, num_arguments, words in scripts:
        start = header_size + len(code)
        directory += struct.pack("<3i", number, start, num_arguments)
        words = [*words, _TERMINATE]
        code += struct.pack(f"<{len(words)}i", *words)
    strings = [text.encode("ascii") + b"\0" for text in _STRINGS]
    table_start = header_size + len(code)
    first_string = table_start + 4 + len(directory) + 4 + 4 * len(strings)
    offsets = [
        first_string + sum(len(text) for text in strings[:i])
        for i in range(len(strings))
    ]
    return b"".join(
        (
            struct.pack("<4si", b"ACS\0", table_start),
            code,
            struct.pack("<i", len(scripts)),
            directory,
            struct.pack(f"<i{len(strings)}i", len(strings), *offsets),
            *strings,
        )
    )
