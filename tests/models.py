"""Settings of networks that are small enough for tests, and a world for them."""

from toponav.config import ModelConfig
from toponav.worlds import WorldSpec

#: What the tests' networks are made for: views like the mazes', six actions.
WORLD = WorldSpec(view_size=(120, 160), actions=tuple("abcdef"))


def tiny_model(**changes: object) -> ModelConfig:
    """The smallest networks of the package, with changes."""
    values = {
        "encoder": "small",
        "embedding_dim": 16,
        "batch_norm": True,
        "share_encoder": True,
        "comparator": "difference",
        "projection_dim": 8,
        "comparator_hidden": [8],
        "locomotion_hidden": [8],
    }
    return ModelConfig(**(values | changes))
