"""Place errors of networks that know a view's pose, or nothing at all."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from toponav.data import HeldOut
from toponav.ground_truth import GroundTruthDistances
from toponav.keys import PRIVILEGED
from toponav.reports.place_errors import place_errors

LANE = "*" * 14 + "\n*" + " " * 12 + "*\n" + "*" * 14


class ByValue:
    """Compares one number a view: the nearer, the more similar."""

    encoder = staticmethod(lambda pixels: pixels[:, 0, 0, :1].float())

    def prepare_memory(self, memory):
        return memory

    def compare_prepared(self, embedding, prepared):
        return -(embedding.unsqueeze(-2) - prepared).abs().sum(-1)


@pytest.fixture
def lane():
    is_open = [[letter == " " for letter in row] for row in LANE.splitlines()]
    return GroundTruthDistances(torch.tensor(is_open), cell_size=128.0)


def walk(shown):
    """Two walks of 12 views from west to east, a cell a decision, facing east."""
    x = (torch.arange(12) + 1.5).repeat(2, 1) * 128
    pixels = shown(x).to(torch.uint8).reshape(2, 12, 1, 1, 1).expand(2, 12, 4, 4, 3)
    truth = {
        "position": torch.stack([x, torch.full_like(x, 192.0)], -1),
        "heading": torch.zeros(2, 12, 1),
    }
    frames = TensorDict({"network_pixels": pixels, PRIVILEGED: truth}, [2, 12])
    return HeldOut(frames, name="lane")


def errors(lane, held_out, min_gap=5):
    networks = SimpleNamespace(tc=ByValue())
    validation = SimpleNamespace(networks=networks, embed=lambda embed, x: embed(x))
    return place_errors(validation, lane, held_out, min_gap=min_gap)


def test_a_network_that_sees_the_place_makes_none(lane):
    found = errors(lane, walk(lambda x: x / 16))
    assert found["place_error"] == found["place_error_revisit"] == 0


def test_twins_elsewhere_are_errors(lane):
    # The lane's two halves look the same: the view six cells on is the very same, and
    # so is the one of the other walk, which comes first for the first walk's west half
    # and last for the second walk's east half only.
    found = errors(lane, walk(lambda x: x % 768 / 16))
    assert found["place_error"] > 0.4
    # Only the last view of each walk looks at the wall: its cell ends half a cell on.
    assert found["far_sighted"] == pytest.approx(22 / 24)


def test_views_of_two_episodes_of_a_walk_are_of_two_visits(lane):
    whole = walk(lambda x: x / 16)
    frames = whole.frames.reshape(2, 12)
    frames["next"] = TensorDict({"done": torch.zeros(2, 12, 1).bool()}, [2, 12])
    frames["next", "done"][:, 1] = True
    frames = frames[:1]
    # One walk of 2 + 10 views with nothing but its own: a visit is five decisions. The
    # first two views are now of another visit than the next four, a cell or two away.
    alone = HeldOut(whole.frames.reshape(2, 12)[:1].exclude("next"), name="lane")
    assert errors(lane, alone)["place_error_revisit"] == 1
    cut = errors(lane, HeldOut(frames, name="lane"))
    # Views 0 and 1 find 2, which is two cells off or less; 2 and 3 find 1; all later
    # ones look at least three cells back.
    assert cut["place_error_revisit"] == pytest.approx(8 / 12)
