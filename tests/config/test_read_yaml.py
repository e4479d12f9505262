"""YAML files of a run are read fast or refused, whatever somebody put into them."""

import time
from pathlib import Path

import pytest
from omegaconf import ListConfig

from toponav.config import SettingsError, read_yaml

#: 400 bytes that stand for 43 million words.
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join(9 * [f'*{before}'])}]\n"
    for before, name in zip("abcdefg", "bcdefgh", strict=True)
)


def refused(file: Path, text: str) -> str:
    file.write_text(text)
    started = time.monotonic()
    with pytest.raises(SettingsError) as refusal:
        read_yaml(file)
    assert time.monotonic() - started < 5
    said = str(refusal.value)
    rule = f"a run folder must hold the settings of a run, got the damaged {file} ("
    assert said.startswith(rule)
    assert "\n" not in said
    return said.removeprefix(rule)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "text",
    [BOMB, "a: &a {b: 1}\nc: {<<: *a}\n", "&a [*a]\n"],
    ids=["bomb", "merge", "itself"],
)
def test_aliases_are_refused(tmp_path: Path, text: str) -> None:
    assert refused(tmp_path / "config.yaml", text) == "it has an alias, '*a')"


def test_what_is_longer_than_all_settings_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("a: 1\n" + "#" * (50_000 - 6) + "\n")
    assert read_yaml(file) == {"a": 1}
    text = "a: 1\n" + "#" * (50_000 - 5) + "\n"
    assert refused(file, text) == "it has more than 50,000 bytes)"


@pytest.mark.timeout(60)
@pytest.mark.parametrize("word", ["[", "{a: ", "- "])
def test_what_is_nested_deeply_is_refused(tmp_path: Path, word: str) -> None:
    assert refused(tmp_path / "config.yaml", 49_000 // len(word) * word)


def test_words_with_stars_and_ands_are_read(tmp_path: Path) -> None:
    file = tmp_path / "overrides.yaml"
    file.write_text("- maze=maze1\n- 'a=*b'\n- c=&d *e\n")
    assert read_yaml(file, ListConfig) == ["maze=maze1", "a=*b", "c=&d *e"]


def test_references_that_double_are_refused(tmp_path: Path) -> None:
    def chain(number: int) -> str:
        lines = [f"a{at}: ${{a{at + 1}}}${{a{at + 1}}}\n" for at in range(number)]
        return "".join([*lines, f"a{number}: x\n"])

    file = tmp_path / "config.yaml"
    rule = "it has more than 30 references, '${...}')"
    assert refused(file, chain(16)) == rule
    file.write_text(chain(15))
    assert read_yaml(file)["a12"] == 8 * "x"
