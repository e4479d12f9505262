"""What the examples in docstrings find without an import."""

from typing import Any

import pytest
from tensordict import TensorDict


@pytest.fixture(autouse=True)
def add_to_examples(doctest_namespace: dict[str, Any]) -> None:
    """Add `TensorDict`, which most of them use."""
    doctest_namespace["TensorDict"] = TensorDict
