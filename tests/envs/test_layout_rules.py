"""Every broken rule is one sentence with line and column."""

import os
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from tests.envs.layouts import steps_from
from toponav.envs import Layout, LayoutError, load_layout_file

# Name -> text, line, column (None where there is no one place), part of the message.
BROKEN: dict[str, tuple[str, int | None, int | None, str]] = {
    "empty": ("", 1, None, "first line must not be empty"),
    "only newlines": ("\n\n\n", 1, None, "first line must not be empty"),
    "empty first line": ("\n***\n* *\n***", 1, None, "first line must not be empty"),
    "line too short": ("****\n*  *\n***\n****", 3, 4, r"\(4 characters\), got 3"),
    "line too long": ("****\n*  *\n*****", 3, 5, r"\(4 characters\), got 5"),
    "empty line inside": ("***\n* *\n\n***", 3, 1, r"\(3 characters\), got 0"),
    "two lines": ("***\n***", 1, None, "number of lines must be between 3 and 101"),
    "two columns": ("**\n**\n**", 1, None, "characters in a line must be .* got 2"),
    "too many lines": ("***\n" + "* *\n" * 100 + "***", 1, None, "got 102"),
    "too wide": ("\n".join(["*" * 102] * 3), 1, None, "101, got 102"),
    "capital": ("*****\n* A *\n*****", 2, 3, "a to z .slot., got 'A'"),
    "digit": ("*****\n*  1*\n*****", 2, 4, "got '1'"),
    "tab": ("*****\n*\t  *\n*****", 2, 2, r"got '\\t'"),
    "umlaut": ("*****\n*   *\n*ä  *\n*****", 3, 2, "got 'ä'"),
    "lone carriage return": ("*****\n*  \r*\n*****", 2, 4, r"got '\\r'"),
    "slot twice": (
        "*****\n*a a*\n*****",
        2,
        4,
        "once, got 'a' here and at line 2, col",
    ),
    "open at the top": ("** *\n*  *\n****", 1, 3, "border must be wall .*, got ' '"),
    "open at the left": ("****\n   *\n****", 2, 1, "border must be wall"),
    "open at the right": ("****\n*   \n****", 2, 4, "border must be wall"),
    "open at the bottom": ("****\n*  *\n** *", 3, 3, "border must be wall"),
    "slot in the border": ("****\na  *\n****", 2, 1, "border must be wall .*, got 'a'"),
    "no floor": ("***\n***\n***", None, None, "at least one floor cell, got none"),
    "only a slot": ("***\n*a*\n***", None, None, "at least one floor cell, got none"),
    "cut off": ("*****\n* * *\n*****", 2, 4, "cut off from line 2, column 2"),
    "joined by a corner": ("****\n* **\n** *\n****", 3, 3, "must be reachable"),
    "slot that cuts": ("*****\n* a *\n*****", 2, 3, "slot 'a' cuts it in two"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_rule_names_line_and_column(name: str) -> None:
    text, line, column, message = BROKEN[name]
    with pytest.raises(LayoutError, match=message) as caught:
        Layout(text, name="mine")
    assert (caught.value.line, caught.value.column) == (line, column)
    place = "layout 'mine'"
    place += "" if line is None else f", line {line}"
    place += "" if column is None else f", column {column}"
    assert str(caught.value).startswith(f"{place}: ")


@pytest.mark.parametrize(
    "text",
    ["***\n* *\n***", "***\r\n* *\r\n***\r\n", "***\n* *\n***\n\n\n"],
    ids=["plain", "carriage returns", "blank lines at the end"],
)
def test_line_ends_do_not_matter(text: str) -> None:
    assert Layout(text).rows == ("***", "* *", "***")


def test_the_longest_side_is_allowed() -> None:
    assert Layout("***\n" + "* *\n" * 99 + "***").shape == (101, 3)


@settings(max_examples=300, deadline=None)
@given(st.text(max_size=60) | st.text("* ab\n\r\t*", max_size=60))
def test_any_text_is_a_layout_or_a_layout_error(text: str) -> None:
    try:
        layout = Layout(text)
    except LayoutError as error:
        assert "must" in str(error)  # noqa: PT017 - most texts are errors
    else:
        assert layout.num_cells >= 1


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.text("*** a", min_size=4, max_size=4), min_size=1, max_size=4),
    st.booleans(),
)
def test_any_rectangle_is_a_layout_or_a_layout_error(
    rows: list[str], framed: bool
) -> None:
    if framed:
        rows = ["******", *(f"*{row}*" for row in rows), "******"]
    try:
        layout = Layout("\n".join(rows))
    except LayoutError:
        return
    for slot in layout.slots:
        assert len(steps_from(layout, layout.cells[0])) == layout.num_cells
        assert layout.check_slots(slot) == (slot,)


@settings(max_examples=100, deadline=None)
@given(content=st.binary(max_size=80))
def test_any_bytes_in_a_file_are_a_layout_or_a_layout_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_bytes(content)
    try:
        assert load_layout_file(path).num_cells >= 1
    except LayoutError:
        return


class TestFiles:
    def test_the_stem_is_the_name(self, tmp_path: Path) -> None:
        path = tmp_path / "mine.txt"
        path.write_text("***\n* *\n***\n")
        assert load_layout_file(path) == Layout("***\n* *\n***\n", name="mine")
        assert load_layout_file(str(path)).name == "mine"

    def test_windows_files_are_read(self, tmp_path: Path) -> None:
        path = tmp_path / "windows.txt"
        path.write_bytes(b"\xef\xbb\xbf***\r\n* *\r\n***\r\n")
        assert load_layout_file(path).rows == ("***", "* *", "***")

    def test_a_missing_file_is_named(self, tmp_path: Path) -> None:
        path = tmp_path / "none.txt"
        with pytest.raises(LayoutError, match=r"none\.txt': the file must exist"):
            load_layout_file(path)

    def test_a_folder_is_not_a_file(self, tmp_path: Path) -> None:
        with pytest.raises(LayoutError, match=r"must be readable .*, got a folder"):
            load_layout_file(tmp_path)

    def test_a_binary_file_is_not_text(self, tmp_path: Path) -> None:
        path = tmp_path / "maze.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
        with pytest.raises(LayoutError, match="must be readable UTF-8 text, got 'utf"):
            load_layout_file(path)

    def test_an_empty_file_is_empty(self, tmp_path: Path) -> None:
        path = tmp_path / "empty.txt"
        path.touch()
        with pytest.raises(LayoutError, match="line 1: the first line must not be"):
            load_layout_file(path)


@pytest.mark.parametrize("kind", ["pipe", "device", "huge"])
def test_what_has_no_end_is_not_read_to_it(kind: str, tmp_path: Path) -> None:
    path = Path("/dev/zero") if kind == "device" else tmp_path / "mine.txt"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "huge":
        path.write_text("*" * 100_001)
    reason = "more than 100000 characters" if kind == "huge" else "a folder, pipe or"
    with pytest.raises(LayoutError, match=f"readable UTF-8 text, got {reason}"):
        load_layout_file(path)


def test_a_name_with_a_line_break_stays_on_one_line() -> None:
    with pytest.raises(LayoutError) as caught:
        Layout("", name="a\nb")
    assert str(caught.value).startswith(r"layout 'a\nb', line 1: ")
