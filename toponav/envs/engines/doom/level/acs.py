"""The maze's engine scripts, assembled to ACS bytecode.

Python starts them with the console command ``puke``. Positions are 16.16 fixed point,
angles 65536ths of a turn, counter-clockwise from east. ACS global variable n is read in
Python as ``GameVariable.USERn``.
"""

import struct
from collections.abc import Iterable, Sequence
from itertools import accumulate

from toponav.envs.engines.doom.spec import ROOM_HEIGHT

#: Script numbers, for ``puke``.
PLACE_PLAYER = 1
APPLE_TOUCHED = 2
GOAL_TOUCHED = 3
SET_RESPAWN = 4
SPAWN_APPLE = 5
CLOSE_SLOT = 7
OPEN_SLOT = 8
SPAWN_GOAL = 9

#: Thing tag of the goal; apples carry ``APPLE_TID + i``.
GOAL_TID = 99
APPLE_TID = 100

_STRINGS = ("MazeApple", "MazeGoal")

_TERMINATE = 1
_PUSH_NUMBER = 3
# Line specials of three arguments.
_SPECIAL_OF_3 = 6
_ASSIGN_MAP = 26
_PUSH_ARGUMENT = 28
_PUSH_MAP = 29
_DROP = 54
_INC_GLOBAL = 188
_SET_ACTOR_ANGLE = 276
_SET_ACTOR_POSITION = 283
_CALL_FUNCTION = 351

_FUNCTION_SET_VELOCITY = 23
_FUNCTION_SPAWN_FORCED = 36

_FLOOR_LOWER_INSTANT = 66
_FLOOR_RAISE_INSTANT = 67

# Map variables: where the next respawn puts the player, and the goal's place.
_RESPAWN_X_Y_ANGLE = (0, 1, 2)
_GOAL_X_Y = (3, 4)

# An instruction pushes its operands, then acts on them.
_Code = list[int]


def _push(*values: int) -> _Code:
    return [word for value in values for word in (_PUSH_NUMBER, value)]


def _load(opcode: int, indices: Iterable[int]) -> list[_Code]:
    """Push arguments of the script, or map variables, one each."""
    return [[opcode, index] for index in indices]


def _store(variables: Sequence[int]) -> _Code:
    """Keep the script's arguments in map variables."""
    return [
        word
        for argument, variable in enumerate(variables)
        for word in (_PUSH_ARGUMENT, argument, _ASSIGN_MAP, variable)
    ]


def _move_player(x: _Code, y: _Code, angle: _Code) -> _Code:
    """Put the activator (0) at a pose on the ground without fog and stop it."""
    return [
        *(*_push(0), *x, *y, *_push(0, 0), _SET_ACTOR_POSITION, _DROP),
        *(*_push(0), *angle, _SET_ACTOR_ANGLE),
        # The activator, no velocity, in place of the old one.
        *(*_push(0, 0, 0, 0, 0, 0), _CALL_FUNCTION, 6, _FUNCTION_SET_VELOCITY, _DROP),
    ]


def _spawn(name: str, x: _Code, y: _Code, tid: _Code) -> _Code:
    """Put a thing on the ground, facing east."""
    return [
        *(*_push(_STRINGS.index(name)), *x, *y, *_push(0), *tid, *_push(0)),
        *(_CALL_FUNCTION, 6, _FUNCTION_SPAWN_FORCED, _DROP),
    ]


def _move_floor(special: int) -> _Code:
    """Move the floor of the slot whose tag is the argument by the room's height."""
    # The floor specials count heights in steps of eight map units.
    height = ROOM_HEIGHT // 8
    return [_PUSH_ARGUMENT, 0, *_push(0, height), _SPECIAL_OF_3, special]


def _scripts() -> dict[int, tuple[int, _Code]]:
    """Argument count and code of each script."""
    pose = _load(_PUSH_ARGUMENT, range(3))
    respawn = _move_player(*_load(_PUSH_MAP, _RESPAWN_X_Y_ANGLE))
    goal_x, goal_y = _load(_PUSH_MAP, _GOAL_X_Y)
    spawn_goal = _spawn("MazeGoal", goal_x, goal_y, _push(GOAL_TID))
    return {
        PLACE_PLAYER: (3, _move_player(*pose)),
        APPLE_TOUCHED: (0, [_INC_GLOBAL, 1]),
        # The engine removes a thing that is picked up, so the goal is spawned again.
        GOAL_TOUCHED: (0, [_INC_GLOBAL, 2, *respawn, *spawn_goal]),
        SET_RESPAWN: (3, _store(_RESPAWN_X_Y_ANGLE)),
        SPAWN_APPLE: (3, _spawn("MazeApple", *pose)),
        CLOSE_SLOT: (1, _move_floor(_FLOOR_RAISE_INSTANT)),
        OPEN_SLOT: (1, _move_floor(_FLOOR_LOWER_INSTANT)),
        SPAWN_GOAL: (2, [*_store(_GOAL_X_Y), *spawn_goal]),
    }


def behavior() -> bytes:
    """The ``BEHAVIOR`` lump: header, code, script directory, string table."""
    header_size = 8
    code = directory = b""
    scripts = _scripts()
    for number, (num_arguments, words) in scripts.items():
        directory += struct.pack("<3i", number, header_size + len(code), num_arguments)
        code += struct.pack(f"<{len(words) + 1}i", *words, _TERMINATE)
    strings = [text.encode("ascii") + b"\0" for text in _STRINGS]
    table_start = header_size + len(code)
    first_string = table_start + 4 + len(directory) + 4 + 4 * len(strings)
    *offsets, _ = accumulate(map(len, strings), initial=first_string)
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
