"""A value that no setting takes is one sentence that names the setting and says why."""

import pytest
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from tests.exploring import explore_settings
from toponav.refusals import sentence_of


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        # Of the recipe itself, of a group, and of the method that was chosen in one.
        ("seed=one", "seed: Value 'one' of type 'str' could not be converted to Int"),
        ("maze.seed=x", "maze.seed: Value 'x' of type 'str' could not be converted to"),
        ("reward.alpha=x", "reward.alpha: Value 'x' of type 'str' could not be conver"),
        ("reward.alpha=${no}", "reward.alpha: Interpolation key 'no' not found"),
        # Another method's, and nobody's.
        ("reward.eta=1", "'reward.eta' must go with reward=icm"),
        ("reward.alpah=1", "'reward.alpah' must be a setting of explore, got none of"),
    ],
)
def test_what_a_setting_does_not_take(word: str, sentence: str) -> None:
    with pytest.raises((HydraException, OmegaConfBaseException)) as refusal:
        explore_settings(word)
    said = sentence_of(refusal.value, "explore")
    assert said is not None
    assert said.startswith(sentence)
    assert "\n" not in said
