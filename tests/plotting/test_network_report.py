import io
from dataclasses import replace

import pytest
import torch

from tests.comparing_networks import Nearness
from tests.fakes import WORLD
from toponav.graph import MAP_SHARE, WalkWaypoints, calibrate_share, share_curve
from toponav.ground_truth import GroundTruthDistances, pair_truth
from toponav.metrics import bayes_bound, l_report, tc_report, useful_actions
from toponav.plotting import draw_report


@pytest.fixture(scope="module")
def report():
    generator = torch.Generator().manual_seed(0)
    here = 20 + 600 * torch.rand(300, 2, generator=generator)
    there = 20 + 600 * torch.rand(300, 2, generator=generator)
    angle = 360 * torch.rand(2, 300, generator=generator)
    distances = GroundTruthDistances(torch.ones(5, 5).bool(), cell_size=128.0)
    headings = (angle[0], angle[1])
    truth = pair_truth(distances, (here, there), headings, motion=WORLD.motion)
    similarity = torch.sigmoid(3 - truth.distance / 60)
    label = (torch.rand(300, generator=generator) < similarity).float()
    mask = useful_actions((here, there), headings, world=WORLD)
    action = torch.randint(6, (300,), generator=generator)
    offset = torch.randint(1, 5, (300,), generator=generator)
    logits = torch.randn(300, 6, generator=generator)
    steps = torch.randn(120, 2, generator=generator)
    walk = WalkWaypoints(steps.cumsum(0), Nearness())
    thresholds = torch.linspace(0.05, 0.95, 9)
    return (
        tc_report(similarity, label, truth, cell_size=128.0),
        l_report(logits, action, offset, mask),
        (thresholds, share_curve([walk, walk], thresholds.tolist())),
        calibrate_share([walk], target_share=MAP_SHARE),
    )


def draw(report):
    tc, locomotion, shares, found = report
    return draw_report(
        tc,
        locomotion,
        shares,
        marks={"map": found},
        bound=bayes_bound(4, world=WORLD),
        num_actions=6,
        pose_bound=0.98,
        title="a maze",
    )


def texts(axes):
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else []


def test_every_panel_has_a_letter_axes_and_its_number_of_pairs(report):
    figure = draw(report)
    panels = figure.axes[:6]
    for letter, axes in zip("abcdef", panels, strict=True):
        assert axes.get_title(loc="left").startswith(f"{letter}  ")
        assert axes.get_xlabel()
        assert axes.get_ylabel()
    assert "n = 300 pairs" in panels[0].get_legend().get_title().get_text()
    assert "from true poses 98.0%" in panels[0].get_legend().get_title().get_text()
    for panel in (1, 2, 5):
        assert "n = 300 pairs" in panels[panel].get_title(loc="left")
    assert "n = 2 random sequences" in panels[4].get_title(loc="left")


def test_marks_lie_on_the_curve_and_are_named(report):
    axes = draw(report).axes[4]
    found = report[3]
    (name,) = [text for text in texts(axes) if text.startswith("map")]
    assert f"{found.threshold:.3f}" in name
    *_, mark = axes.lines
    assert mark.get_xdata()[0] == found.threshold
    assert mark.get_ydata()[0] == found.achieved
    assert name.endswith(f"({found.achieved:.1%})")


def test_a_share_that_was_not_measured_is_said_to_be_read_off_the_curve(report):
    tc, locomotion, shares, found = report
    # Such as the share of close pairs, which is none of waypoints.
    other = replace(found, achieved=0.9, per_sequence=())
    axes = draw((tc, locomotion, shares, other)).axes[4]
    (name,) = [text for text in texts(axes) if text.startswith("map")]
    *_, mark = axes.lines
    read = mark.get_ydata()[0]
    assert read == pytest.approx(found.achieved, rel=0.3)
    assert name.endswith(f"(about {read:.1%})")


def test_bins_of_few_pairs_are_marked_as_such(report):
    assert "under 100 pairs" in texts(draw(report).axes[3])


def test_figure_can_be_written(report):
    file = io.BytesIO()
    draw(report).savefig(file, format="png", dpi=40)
    assert file.getvalue().startswith(b"\x89PNG")
