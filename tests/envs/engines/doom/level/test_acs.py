"""The engine's scripts, read back with a disassembler of their own."""

import struct

from toponav.envs.engines.doom.level import acs

# Opcode -> number of words that follow it in the code.
_WORDS = {
    1: 0,  # terminate
    3: 1,  # push number
    **{4 + i: 1 for i in range(5)},  # line special with 1 to 5 arguments
    26: 1,  # assign map variable
    28: 1,  # push script argument
    29: 1,  # push map variable
    54: 0,  # drop
    188: 1,  # increment global variable
    276: 0,  # set actor angle
    283: 0,  # set actor position
    351: 2,  # call function: number of arguments, function
}
# Opcode -> change of the stack's height, where the words do not decide it.
_STACK = {1: 0, 3: 1, 26: -1, 28: 1, 29: 1, 54: -1, 188: 0, 276: -2, 283: -4}


def directory() -> dict[int, tuple[int, int]]:
    """Script number -> start of its code and number of arguments."""
    lump = acs.behavior()
    (start,) = struct.unpack_from("<i", lump, 4)
    (count,) = struct.unpack_from("<i", lump, start)
    entries = [
        struct.unpack_from("<3i", lump, start + 4 + 12 * i) for i in range(count)
    ]
    return {number: (code, arguments) for number, code, arguments in entries}


def instructions(start: int) -> list[tuple[int, ...]]:
    """Opcode and words of every instruction up to the script's end."""
    lump, found = acs.behavior(), []
    while not found or found[-1][0] != 1:
        (opcode,) = struct.unpack_from("<i", lump, start)
        number = 1 + _WORDS[opcode]
        found.append(struct.unpack_from(f"<{number}i", lump, start))
        start += 4 * number
    return found


def test_there_are_nine_scripts_with_at_most_three_arguments() -> None:
    # The console command hands over three arguments at most.
    assert {number: count for number, (_, count) in directory().items()} == {
        acs.PLACE_PLAYER: 3,
        acs.APPLE_TOUCHED: 0,
        acs.GOAL_TOUCHED: 0,
        acs.SET_RESPAWN: 3,
        acs.SPAWN_APPLE: 3,
        acs.CLOSE_SLOT: 1,
        acs.OPEN_SLOT: 1,
        acs.SPAWN_GOAL: 2,
    }


def test_every_script_leaves_an_empty_stack() -> None:
    for number, (start, num_arguments) in directory().items():
        height = 0
        for opcode, *words in instructions(start):
            if opcode == 351:  # takes its arguments, leaves its result
                height += 1 - words[0]
            elif 4 <= opcode <= 8:
                height -= opcode - 3
            else:
                height += _STACK[opcode]
            if opcode == 28:
                assert words[0] < num_arguments
            assert height >= 0, number
        assert height == 0, number


def test_touching_counts_in_its_own_variable() -> None:
    counted = [
        [
            words
            for opcode, *words in instructions(directory()[script][0])
            if opcode == 188
        ]
        for script in (acs.APPLE_TOUCHED, acs.GOAL_TOUCHED)
    ]
    assert counted == [[[1]], [[2]]]


def test_slots_move_by_the_rooms_height() -> None:
    # Floor_RaiseInstant is 67, Floor_LowerInstant 66; 128 units = 16 x 8.
    for script, special in ((acs.CLOSE_SLOT, 67), (acs.OPEN_SLOT, 66)):
        code = instructions(directory()[script][0])
        assert code == [(28, 0), (3, 0), (3, 16), (6, special), (1,)]


def test_the_string_table_names_the_things() -> None:
    lump = acs.behavior()
    assert lump.endswith(b"MazeApple\0MazeGoal\0")
    (start,) = struct.unpack_from("<i", lump, 4)
    table = start + 4 + 12 * 8
    count, first, second = struct.unpack_from("<3i", lump, table)
    assert count == 2
    assert lump[first:].startswith(b"MazeApple\0")
    assert lump[second:].startswith(b"MazeGoal\0")
