"""Retired words stay out of code, settings and documents, inflected ones too."""

import ast
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


#: Whose names are ours to choose; tests may call a reward that was paid so.
NAMED = ("toponav/", "recipes/", "conf/", "benchmarks/", "examples/")


def listed(heading: str) -> list[str]:
    """The words that the glossary lists in the last paragraph below a heading."""
    section = GLOSSARY.read_text(encoding="utf-8").split(heading)[1].split("\n## ")[0]
    return re.findall("`(.+?)`", section.strip().split("\n\n")[-1].replace("\n", " "))


def retired() -> list[str]:
    return listed("## Retired words\n")


def inflected(word: str) -> str:
    """A pattern for the forms of a word, or of the first of several.

    A word is also found in a name, between underscores, and in any case; one with
    capitals is the name of a class, and found as it is written.
    """
    first, *others = map(re.escape, word.split(" "))
    stem = first.removesuffix("e")
    end = "e" if first.endswith("e") else ""
    rest = "".join(f"[ _]{other}" for other in others)
    case = "(?i)" if word.islower() else ""
    form = rf"{stem}({end}|(e?[sdnt]|ing){'?' * (not end)}){rest}"
    return rf"{case}(?<![^\W_]){form}(?![^\W_])"


def names_in(path: Path, text: str) -> set[str]:
    """Names of a Python file or keys of a YAML file."""
    if path.suffix == ".yaml":
        return set(re.findall(r"^\s*(\w+):", text, re.MULTILINE))
    fields = ("name", "id", "attr", "arg", "asname")
    nodes = ast.walk(ast.parse(text)) if path.suffix == ".py" else ()
    return {getattr(node, field, None) for node in nodes for field in fields} - {None}


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
    return [word for word in words if re.search(inflected(word), text)]


def test_the_list_is_read() -> None:
    assert {"born", "gist", "learn on", "whole or not"} <= set(retired())
    assert {"Ways", "paid", "consider"} <= set(listed("## Retired names\n"))


@pytest.mark.parametrize("path", texts(), ids=lambda path: str(path.relative_to(ROOT)))
def test_no_retired_word_is_used(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = RENAME.sub("", text)
    assert found_in(text, retired()) == []


@pytest.mark.parametrize(
    "path",
    [path for path in texts() if str(path.relative_to(ROOT)).startswith(NAMED)],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_no_retired_name_is_used(path: Path) -> None:
    found = names_in(path, path.read_text(encoding="utf-8"))
    assert found & set(listed("## Retired names\n")) == set()


@pytest.mark.parametrize(
    "text", ["def f(paid): ...", "x.paid = 1", "class paid: ...", "f(paid=1)"]
)
def test_a_retired_name_is_seen(text: str) -> None:
    assert "paid" in names_in(Path("some.py"), text)
    assert "paid" not in names_in(Path("some.py"), "x = 'paid'  # paid")


def test_a_rename_may_name_the_retired_word() -> None:
    text = "Renamed: `births` -> `new_waypoints`, and\n`gist` ->\n`format_progress`."
    assert found_in(RENAME.sub("", text), ["births", "gist"]) == []
    assert found_in(RENAME.sub("", "`new` -> `births`"), ["births"]) == ["births"]


def test_a_retired_word_is_seen() -> None:
    assert found_in("a view is born", ["born", "gist"]) == ["born"]
    assert found_in("stubborn", ["born"]) == []


@pytest.mark.parametrize(
    "text", ["make_anew", "anew_made", "_anew", "EXPLORE_ANEW", "Anew.", "x.anew_ = 1"]
)
def test_a_retired_word_is_seen_within_a_name(text: str) -> None:
    assert found_in(text, ["anew"]) == ["anew"]
    assert found_in("renewed, canew, anewly_x", ["anew"]) == []


def test_several_retired_words_are_seen_within_a_name() -> None:
    words = ["for ever", "learn on", "give way"]
    assert found_in("write_for_ever, LEARNED_ON, test_it_gives_way", words) == words
    assert found_in("write_forever, learned_one, gives_ways", words) == []


def test_a_class_is_retired_as_it_is_written() -> None:
    assert found_in("from x import Walks as y", ["Walks"]) == ["Walks"]
    assert found_in("an agent walks; UNIFORM_WALKS; picture_walks", ["Walks"]) == []


def test_inflections_are_seen() -> None:
    words = ["learn on", "give way", "go on learning", "birth", "reckon"]
    forms = "learned on, giving way, goes on learning, births, reckoned"
    assert found_in(forms, words) == words
    assert found_in("what it learns; gives a way; go on", words) == []
