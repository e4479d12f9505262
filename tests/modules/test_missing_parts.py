"""A network that is made of what lacks something says so."""

import pytest
from torch import nn

from tests.refused import Parts, refused
from toponav import modules

PARTS: Parts = {
    "comparator": (
        lambda: modules.TCNetwork(nn.Identity(), nn.Linear(2, 2)),
        "comparator must be such as a ConcatComparator, got Linear without prepare",
    ),
    "encoder": (
        lambda: modules.LNetwork("resnet18", nn.Identity()),
        "encoder must be a function or a network, got str",
    ),
}


@pytest.mark.parametrize("case", PARTS)
def test_a_part_that_lacks_something_is_named(case: str) -> None:
    act, sentence = PARTS[case]
    assert sentence in refused(act)
