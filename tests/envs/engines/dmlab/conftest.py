"""DeepMind Lab twice: a stand-in for its Python module, and itself where installed."""

from collections.abc import Iterator

import pytest

from tests.envs.test_engines import STAND_IN, is_stand_in, needs_dmlab

# pytest would import it where it looks for examples, and find it for good.
collect_ignore = ["stand_in"]


@pytest.fixture(
    scope="module",
    params=[
        "stand-in",
        pytest.param("installed", marks=[needs_dmlab, pytest.mark.slow]),
    ],
)
def module(request: pytest.FixtureRequest) -> Iterator[str]:
    """Which of the two the tests of a file run on."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "stand-in":
            patch.syspath_prepend(str(STAND_IN))
        assert is_stand_in() == (request.param == "stand-in")
        yield request.param


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stand-in alone, also where the engine is installed."""
    monkeypatch.syspath_prepend(str(STAND_IN))
