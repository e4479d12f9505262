from contextlib import nullcontext

import pytest
import torch
from tensordict import TensorDict

from tests.models import WORLD, tiny_model
from tests.training.test_pretraining import settings
from toponav.builders import Networks, make_networks
from toponav.data import HeldOut
from toponav.keys import ACTION, HEADING, NETWORK_PIXELS, POSITION
from toponav.training import Validation


def make_held_out(name: str, episodes: int = 3, length: int = 60) -> HeldOut:
    """Episodes whose views brighten with every decision."""
    step = torch.arange(length).expand(episodes, length)
    data = TensorDict(
        {
            NETWORK_PIXELS: step[..., None, None, None]
            .expand(-1, -1, 60, 80, 3)
            .byte(),
            ACTION: step % 6,
            POSITION: torch.zeros(episodes, length, 2),
            HEADING: torch.zeros(episodes, length, 1),
        },
        [episodes, length],
    )
    return HeldOut(data, name=name)


class Clock(torch.nn.Module):
    """Embed a view as its brightness: the time."""

    def __init__(self) -> None:
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(()))

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        return pixels[..., 0, 0, :1].float()


class Nearness(torch.nn.Module):
    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return 10 - (anchor - other).abs().squeeze(-1)


class NextAction(torch.nn.Module):
    """Knows the action from the time: it is the step modulo six."""

    def forward(self, anchor: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        action = anchor.squeeze(-1).long() % 6
        return torch.nn.functional.one_hot(action, 6).float()


def make_validation(networks: Networks, *names: str) -> Validation:
    config = settings("scale=smoke", "validate.pairs=200", "pairs.k=3")
    held_out = [make_held_out(name) for name in names]
    return Validation(networks, config, held_out, autocast=nullcontext())


def test_perfect_networks_get_full_marks() -> None:
    networks = make_networks(tiny_model(), WORLD)
    networks.tc.encoder = networks.locomotion.encoder = Clock()
    networks.tc.comparator, networks.locomotion.head = Nearness(), NextAction()
    figures = make_validation(networks, "maze1")()
    assert figures == {name: 1.0 for name in figures}
    assert {"tc_accuracy", "tc_accuracy_k4_m5", "l_accuracy_4"} <= set(figures)
    assert "tc_accuracy_maze1" not in figures


def test_it_gives_the_mean_over_the_mazes_and_each_maze() -> None:
    networks = make_networks(tiny_model(), WORLD)
    figures = make_validation(networks, "maze1", "maze2")()
    each = [figures["tc_accuracy_maze1"], figures["tc_accuracy_maze2"]]
    assert figures["tc_accuracy"] == pytest.approx(sum(each) / 2)


@pytest.mark.parametrize("training", [True, False])
def test_it_measures_in_eval_mode_and_leaves_no_trace(training: bool) -> None:
    networks = make_networks(tiny_model(), WORLD)
    networks.modules.train(training)
    before = {k: v.clone() for k, v in networks.modules.state_dict().items()}
    state = torch.get_rng_state()
    validation = make_validation(networks, "maze1")
    assert validation() == validation()
    assert networks.tc.training == training
    assert torch.equal(torch.get_rng_state(), state)
    for name, value in networks.modules.state_dict().items():
        assert torch.equal(value, before[name]), name


def test_embedding_in_pieces_is_embedding_at_once() -> None:
    networks = make_networks(tiny_model(), WORLD)
    encoder = networks.tc.encoder.eval()
    views = torch.randint(0, 256, (300, 60, 80, 3), dtype=torch.uint8)
    pieces = make_validation(networks, "maze1").embed(encoder, views)
    assert torch.allclose(pieces, encoder(views), atol=1e-5)
