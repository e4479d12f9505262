"""Every engine and every world of others has a page, which README lists."""

import re
from pathlib import Path

import pytest

from toponav.envs import ENGINES

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLE = (DOCS / "worlds.md").read_text(encoding="utf-8")
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


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda path: path.stem)
def test_links_of_pages_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, part in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", text):
        file = page.parent / target if target else page
        assert file.exists(), target
        if part:
            heads = re.findall(r"^#+ (.+)$", file.read_text("utf-8"), re.MULTILINE)
            anchors = [
                re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads
            ]
            assert part in anchors, f"{target}#{part}"
