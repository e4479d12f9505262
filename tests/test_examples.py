"""The examples, run as their readers run them."""

import re
import subprocess
import sys
from importlib import import_module
from itertools import product
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(name: str, *words: str) -> str:
    """What an example prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), *words],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_novelty_pays_for_seeing_more_of_another_env() -> None:
    line = r"(\w+): (\d+) of 18 places, (\d+) waypoints, intrinsic return ([\d.]+)"
    found = re.findall(line, run("novelty_on_another_env"))
    assert [name for name, *_ in found] == ["random", "swing"]
    random, swing = ([float(number) for number in numbers] for _, *numbers in found)
    # Without a push in step with the swing the car stays at the bottom of the valley.
    assert random[0] <= 5
    assert swing[0] >= 15
    for places, waypoints, _ in (random, swing):
        assert abs(places - waypoints) <= 4
    assert swing[2] > 2 * random[2]


@pytest.mark.slow
def test_a_whole_program_in_another_world() -> None:
    pytest.importorskip("minigrid", reason="minigrid is not installed (extra: worlds)")
    said = run("curious_minigrid", "--walks=1", "--updates=20", "--batches=2")
    (right,) = re.findall(r"TC-network: ([\d.]+)% of new pairs right", said)
    # Half of the pairs are close, and it has learned for a moment.
    assert 40 < float(right) < 100
    explored = re.findall(r"explorer: ([\d.]+) squares, random: ([\d.]+)", said)
    assert len(explored) == 2
    # Of 260; nothing is learned yet, and both walk.
    assert all(10 < float(number) < 260 for row in explored for number in row)
    assert re.search(r"map: [\d,]+ waypoints, [\d,]+ edges\n", said)
    line = r"after (\d+) decisions: by the map (\d+)%, at random (\d+)%"
    rows = [[*map(int, row)] for row in re.findall(line, said)]
    assert [after for after, *_ in rows] == [64, 128, 192, 256]
    for shares in ([row[1] for row in rows], [row[2] for row in rows]):
        # Who has come to a place has come there; of 64 pictures some are near.
        assert shares == sorted(shares)
        assert 0 < shares[-1] < 100


def test_places_of_the_painted_rooms_look_different(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("minigrid", reason="minigrid is not installed (extra: worlds)")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    rooms = import_module("painted_rooms").PaintedRooms()
    rooms.reset(seed=0)
    squares = [
        (column, row)
        for row, column in product(range(rooms.height), range(rooms.width))
        if (thing := rooms.grid.get(column, row)) is None or thing.can_overlap()
    ]
    # Four rooms of 8 x 8 squares and four doors.
    assert len(squares) == 4 * 8 * 8 + 4
    views = set()
    for rooms.agent_pos, rooms.agent_dir in product(squares, range(4)):
        views.add(rooms.get_frame(tile_size=4, agent_pov=True).tobytes())
    # Of 260 squares in four directions; without tiles it would be 712.
    assert 1030 <= len(views) <= 4 * 260
