"""Every engine and every world of others has a page, which README lists."""

import re
import shlex
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.exploring import explore_settings, world_of
from toponav.envs import ENGINES
from toponav.keys import PIXELS, POSITION

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLE = (DOCS / "worlds.md").read_text(encoding="utf-8")
# The package of each.
PACKAGES = {"minigrid": "minigrid", "miniworld": "miniworld", "atari": "ale_py"}
OTHERS = re.findall(r"^\| \[\w+\]\((\w+)\.md\) \|", TABLE, re.MULTILINE)


def test_the_worlds_of_others_are_found() -> None:
    assert OTHERS == ["minigrid", "miniworld", "atari"]


@pytest.mark.parametrize("world", [*ENGINES, *OTHERS])
def test_a_world_has_a_page_with_a_command(world: str) -> None:
    page = (DOCS / f"{world}.md").read_text(encoding="utf-8")
    assert f"(docs/{world}.md)" in README
    assert "recipes/explore.py" in page
    chosen = f"engine={world}" if world in ENGINES else "world=gym world.id="
    assert chosen in page


@pytest.mark.parametrize("world", OTHERS)
def test_the_command_of_a_page_makes_its_world(world: str) -> None:
    if find_spec(PACKAGES[world]) is None:
        pytest.skip(f"{PACKAGES[world]} is not installed (the extra worlds)")
    page = (DOCS / f"{world}.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```bash\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    words = shlex.split(block.replace("\\\n", ""))[2:]  # without what runs the recipe
    made = world_of(explore_settings(*words))
    with closing(made.make_env(batch_size=2, seed=0, privileged=True)) as env:
        played = env.rollout(5)
    assert played[PIXELS].shape == (2, 5, *made.spec.view_size, 3)
    assert len(played[PIXELS].unique()) > 1
    # The page of Atari says that it has no position.
    has_positions = any(word.startswith("world.position") for word in words)
    assert has_positions == (world != "atari")
    assert (POSITION in played.keys(True)) == has_positions
