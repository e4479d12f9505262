"""The examples, run as their readers run them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.slow
def test_novelty_pays_for_seeing_more_of_another_env() -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "novelty_on_another_env.py")],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    line = r"(\w+): (\d+) of 18 places, (\d+) waypoints, intrinsic return ([\d.]+)"
    found = re.findall(line, done.stdout)
    assert [name for name, *_ in found] == ["random", "swing"]
    random, swing = ([float(number) for number in numbers] for _, *numbers in found)
    # Without a push in step with the swing the car stays at the bottom of the valley.
    assert random[0] <= 5
    assert swing[0] >= 15
    for places, waypoints, _ in (random, swing):
        assert abs(places - waypoints) <= 4
    assert swing[2] > 2 * random[2]
