"""The report of networks, in worlds with and without ground truth."""

import json
from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from tests.cut_walks import one_start, two_rooms
from tests.models import WORLD, tiny_model
from tests.training.test_pretraining import settings
from toponav.builders import engine_world, make_networks
from toponav.data import HeldOut
from toponav.envs import DEFAULT_ENGINE, load_layout_file
from toponav.keys import ACTION, HEADING, NETWORK_PIXELS, POSITION
from toponav.reports import pretraining_report, summarize, write_reports
from toponav.training import Validation

MAZE_WORLD = engine_world(DEFAULT_ENGINE)


def make_world(layout, spec, *, blocked=()):
    floor = torch.tensor(layout.open_mask)
    for letter in blocked:
        floor[layout.slots[letter]] = False
    return SimpleNamespace(layout=layout, spec=spec, floor=floor)


def make_held_out(name, *, poses):
    generator = torch.Generator().manual_seed(0)
    shape = (3, 60)
    frames = {
        NETWORK_PIXELS: torch.randint(256, (*shape, 60, 80, 3), generator=generator),
        ACTION: torch.randint(6, shape, generator=generator),
    }
    frames[NETWORK_PIXELS] = frames[NETWORK_PIXELS].to(torch.uint8)
    if poses:
        # To and fro in the lane.
        x = 192 + 30 * (30 - torch.arange(60)).abs().float().expand(shape)
        frames[POSITION] = torch.stack([x, torch.full(shape, 192.0)], -1)
        frames[HEADING] = torch.zeros(*shape, 1)
    return HeldOut(TensorDict(frames, shape), name=name)


@pytest.fixture
def lane(tmp_path):
    path = tmp_path / "lane.txt"
    path.write_text("*" * 14 + "\n*" + " " * 11 + "a*\n" + "*" * 14)
    return load_layout_file(path)


@pytest.fixture
def validation():
    torch.manual_seed(0)
    config = settings("scale=smoke", "validate.pairs=200", "pairs.k=3")
    networks = make_networks(tiny_model(), WORLD)
    held_out = [make_held_out("chain", poses=False), make_held_out("lane", poses=True)]
    networks.modules.eval()
    return config, Validation(networks, config, held_out, autocast=nullcontext())


def test_a_world_without_truth_has_thresholds_and_what_needs_none(
    validation, lane, tmp_path
):
    config, validate = validation
    worlds = [
        make_world(lane, WORLD),  # a layout alone is no truth
        make_world(lane, MAZE_WORLD),
    ]
    figures = write_reports(tmp_path, validate, worlds, config)
    assert set(figures["chain"]) == {"accuracy", "auc"} | {
        f"accuracy_{offset}" for offset in range(1, 5)
    }
    assert {"place_error", "pose_bound", *figures["chain"]} <= set(figures["lane"])
    assert set(validate.networks.thresholds) == {
        "tc_threshold",
        "tc_reach",
        "reward_threshold",
    }
    report = json.loads((tmp_path / "report.json").read_text())
    assert set(report["mazes"]) == {"chain", "lane"}
    assert (tmp_path / "report_lane.png").is_file()
    assert not (tmp_path / "report_chain.png").is_file()
    first, second, _ = summarize(figures, validate.networks).splitlines()
    assert first.startswith("chain: TC ")
    assert "place error" in second
    assert "place error" not in first


def test_slots_that_stay_closed_are_walls_to_what_is_measured(
    validation, lane, tmp_path, monkeypatch
):
    config, validate = validation
    floors, make = [], pretraining_report.GroundTruthDistances

    def note(floor, **named):
        floors.append(floor)
        return make(floor, **named)

    monkeypatch.setattr(pretraining_report, "GroundTruthDistances", note)
    worlds = make_world(lane, WORLD), make_world(lane, MAZE_WORLD, blocked="a")
    write_reports(tmp_path, validate, worlds, config)
    # Of the twelve cells of the lane the last one is closed.
    assert [int(floor.sum()) for floor in floors] == [11]
    assert not floors[0][lane.slots["a"]]


def calibrated(held_out, tc, folder):
    """The thresholds that a report finds on walks in a world without ground truth."""
    measured = {"tc_accuracy": 0.5, "tc_auc": 0.5}
    networks = SimpleNamespace(tc=tc, thresholds={})
    validate = SimpleNamespace(
        networks=networks,
        held_out=[held_out],
        embed=lambda encoder, views: encoder(views),
        autocast=nullcontext(),
        measure=lambda number: measured,
    )
    world = SimpleNamespace(layout=None, spec=WORLD)
    write_reports(folder, validate, [world], settings("pairs.k=3"))
    return networks.thresholds


def test_views_of_two_episodes_are_no_close_pair(tmp_path):
    found = calibrated(*two_rooms(), tmp_path)
    # An eighth of 32 views are the four places, at 1 / (1 + exp(-1)).
    assert found["tc_threshold"] == pytest.approx(0.731, abs=0.001)
    # Of 8 x (3 + 2 + 1) pairs in a walk, 8 x 2 are of one place and 8 x 4 of two. With
    # those over 7 ends, 7 x (1 + 2 + 3) more, a tenth would lie below 0.52.
    assert found["tc_reach"] == pytest.approx(0.6)


def test_what_an_earlier_episode_saw_is_new_to_the_reward_but_not_to_the_map(tmp_path):
    found = calibrated(*one_start(), tmp_path)
    # At 0.731 the map has 3 waypoints of 200 views; an eighth of them is too many.
    assert found["tc_threshold"] == pytest.approx(0.731, abs=0.001)
    # There the reward's memory would have 2 in each episode, (1 + 20) / 200 of the
    # views without those that begin the other 19. At 0.5 it is 1 + 2, 1.5 %.
    assert found["reward_threshold"] == 0.5
