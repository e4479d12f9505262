"""Every reward, learner and navigator has a page, and the list of pages names it."""

import re
from pathlib import Path

import pytest

from toponav.methods import METHODS

FOLDER = Path(__file__).parent.parent / "docs" / "methods"
LIST = (FOLDER / "README.md").read_text(encoding="utf-8")
CHOICES = [
    (group, name)
    for group in ("reward", "loss", "navigator")
    for name in METHODS[group]
]


@pytest.mark.parametrize(("group", "name"), CHOICES, ids="=".join)
def test_the_list_links_a_page_that_speaks_of_it(group: str, name: str) -> None:
    (row,) = [line for line in LIST.splitlines() if f"`{group}=`" in line]
    links = re.findall(r"\[([^]]+)\]\((\w+\.md)\)", row)
    (page,) = [file for names, file in links if name in names.split(", ")]
    text = (FOLDER / page).read_text(encoding="utf-8")
    assert re.search(rf"`{group}={name}`|`{name}`|{group}={name}\b", text)
