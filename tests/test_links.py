"""Links within the pages of the project lead to files and headings that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").rglob("*.md"),
    *(ROOT / "results").rglob("*.md"),
]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]


def anchors(page: Path) -> set[str]:
    """What a link into a page may name, as GitHub makes it of headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = set(re.findall(r'<a id="([^"]+)">', text))
    for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        found.add(re.sub(r"[^\w\- ]", "", shown).strip().replace(" ", "-"))
    return found


def broken_links(page: Path) -> list[str]:
    """The links of a page that lead nowhere in the project."""
    broken = []
    for link in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", page.read_text()):
        path, _, anchor = link.partition("#")
        there = page.parent / path if path else page
        is_known = there.exists() and (not anchor or anchor in anchors(there))
        broken += [] if is_known else [link]
    return broken


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    assert broken_links(page) == []


def test_a_link_to_nothing_is_found(tmp_path: Path) -> None:
    other = tmp_path / "other.md"
    other.write_text("# Two `words`, here\n\n```bash\n# no heading\n```\n")
    page = tmp_path / "page.md"
    page.write_text(
        "[a](other.md#two-words-here) [b](other.md) [c](https://x.org/y#z) "
        "[d](other.md#no-heading) [e](gone.md) [f](#here)\n## Here\n[g](#there)"
    )
    assert broken_links(page) == ["other.md#no-heading", "gone.md", "#there"]
