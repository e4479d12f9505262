import math
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from tests.metrics.test_navigation_metrics import AROUND, DISTANCES, STRAIGHT, trace_of
from toponav.builders import GroundTruth
from toponav.envs import Layout
from toponav.reports import markdown_summary, navigation_report, write_path

RING = Layout("*******\n*  a  *\n* *** *\n*     *\n*******", name="ring")


def test_a_table_says_nothing_where_there_is_nothing():
    rows = [{"policy": "oracle", "goals": 2.0, "delay": math.nan}]
    rows.append({"policy": "navigator", "goals": 1.0, "delay": 7.0})
    rows[1] |= {"goals_low": 0.5, "goals_high": 1.5}
    lines = markdown_summary(rows, title="ring").splitlines()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    assert table[0] == ["", "oracle", "navigator"]
    assert table[2:] == [["goals", "2", "1 (0.5 to 1.5)"], ["delay", "", "7"]]


@pytest.mark.parametrize(
    ("cut_at", "title"),
    [
        # Legs of 4, 8 and 2 decisions: with nothing closed that of median length.
        (None, "episode 0: 4 decisions, reached, 0 cuts"),
        (5, "episode 0: 8 decisions, reached, 1 cuts"),
        # The last one did not reach its goal.
        (14, "episode 0: 4 decisions, reached, 0 cuts"),
    ],
)
def test_the_path_is_not_the_easiest_one(
    cut_at: int | None,
    title: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cells = [*STRAIGHT, *AROUND, *STRAIGHT[:2], *STRAIGHT[:2]]
    cuts = np.full(len(cells), -1)
    if cut_at is not None:
        cuts[cut_at] = 0
    trace = trace_of(cells, reached=(3, 11, 13), cut_from=cuts, cut_to=cuts)
    draw = Mock()
    monkeypatch.setattr(navigation_report.plotting, "draw_leg", draw)
    monkeypatch.setattr(navigation_report.plotting, "save_figure", Mock())
    truth = GroundTruth(torch.zeros(1, 3), RING, DISTANCES)
    known = Mock()
    known.map.edges = known.map.graph.traversals = np.empty((0, 2))
    write_path(tmp_path, Mock(trace=trace, map=None), known, truth)
    assert draw.call_args.kwargs["title"] == title
