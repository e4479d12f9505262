"""The code of docs/parts.md runs as it stands."""

import re
from pathlib import Path

import pytest
import torch
from torch import Tensor

from toponav import graph

PAGE = (Path(__file__).parent.parent / "docs/parts.md").read_text(encoding="utf-8")
PROGRAM, CALIBRATION = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.slow
def test_a_whole_agent_of_channels_first_and_one_hot_actions(
    capsys: pytest.CaptureFixture[str],
) -> None:
    torch.manual_seed(0)
    names: dict[str, object] = {}
    exec(PROGRAM, names)
    batch, policy = names["batch"], names["policy"]
    assert batch["pixels"].shape == (4, 64, 3, 400, 600)  # type: ignore[index]
    assert batch["action"].shape == (4, 64, 3)  # type: ignore[index]
    # New views are paid more than 0.8, known ones at most 0.2.
    said = re.findall(r"paid for a decision: ([\d.]+)", capsys.readouterr().out)
    assert len(said) == 2
    assert all(0 < float(number) < 0.8 for number in said)
    # Both batches trained it.
    torch.manual_seed(0)
    kind, options = type(policy), {"num_actions": 3, "channels": "CHW", "one_hot": True}
    for name, weight in kind(**options).named_parameters():  # type: ignore[attr-defined]
        assert not torch.equal(weight, policy.get_parameter(name)), name  # type: ignore[attr-defined]


class Nearness:
    """The comparator of a `TCNetwork`, without weights."""

    def prepare_memory(self, memory: Tensor) -> Tensor:
        return memory

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        return torch.exp(-(embedding.unsqueeze(-2) - prepared).norm(dim=-1))


def test_a_threshold_of_random_walks() -> None:
    torch.manual_seed(0)
    episodes = torch.randn(4, 200, 2).cumsum(1) / 10
    names = {"graph": graph, "tc_network": Nearness(), "episodes": episodes}
    exec(CALIBRATION, names)
    walks, threshold = names["walks"], names["threshold"]
    new = sum(len(walk.times(threshold)) for walk in walks)  # type: ignore[attr-defined]
    # 1.5 % of 800 views, or the nearest that a walk's share can be.
    assert 8 <= new <= 16
