"""Retired words stay out of code, settings and documents."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
GLOSSARY = ROOT / "docs" / "glossary.md"
SUFFIXES = {".py", ".md", ".yaml", ".toml", ".sh"}
EXEMPT = {GLOSSARY, Path(__file__)}
#: In a document, `old` -> `new` says what a retired name is called now.
RENAME = re.compile(r"`[^`\n]+`(?=\s+->\s+`)")


def retired() -> list[str]:
    section = GLOSSARY.read_text(encoding="utf-8").split("## Retired words")[1]
    return re.findall(r"`([^`/]+)`", section.split(":", 1)[1])


def texts() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    paths = [ROOT / line for line in listed.stdout.splitlines()]
    return [
        path
        for path in paths
        if path.suffix in SUFFIXES and path not in EXEMPT and path.is_file()
    ]


def found_in(text: str, words: list[str]) -> list[str]:
    return [
        word for word in words if re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text)
    ]


def test_the_list_is_read() -> None:
    assert {"born", "gist", "learn on"} <= set(retired())


@pytest.mark.parametrize("path", texts(), ids=lambda path: str(path.relative_to(ROOT)))
def test_no_retired_word_is_used(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = RENAME.sub("", text)
    assert found_in(text, retired()) == []


def test_a_rename_may_name_the_retired_word() -> None:
    text = "Renamed: `births` -> `new_waypoints`, and\n`gist` ->\n`format_progress`."
    assert found_in(RENAME.sub("", text), ["births", "gist"]) == []
    assert found_in(RENAME.sub("", "`new` -> `births`"), ["births"]) == ["births"]


def test_a_retired_word_is_seen() -> None:
    assert found_in("a view is born", ["born", "gist"]) == ["born"]
    assert found_in("stubborn", ["born"]) == []
