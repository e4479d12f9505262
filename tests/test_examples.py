"""The examples, run as their readers run them."""

import re
import subprocess
import sys
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
    explored = re.findall(r"explorer: ([\d.]+) squares, random: ([\d.]+)", said)
    assert len(explored) == 2
    # Of 260; nothing is learned yet, and both walk.
    assert all(10 < float(number) < 260 for row in explored for number in row)
    assert re.search(r"map: [\d,]+ waypoints, [\d,]+ edges\n", said)
