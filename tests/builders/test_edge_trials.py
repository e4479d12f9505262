"""The file of what a practice found out about the edges of its map."""

from pathlib import Path

import pytest
import torch

from tests.damaged import OTHER_WEIGHTS, refusing, replace
from toponav.builders import TRIALS_FILE, load_trials, save_trials
from toponav.config import SettingsError
from toponav.graph import EdgeTrials

EDGES = torch.tensor([[0, 1], [1, 2]])


def test_it_loads_as_it_was(tmp_path: Path) -> None:
    trials = EdgeTrials(EDGES)
    ends, passed = torch.tensor([[1, 2], [1, 0]]), torch.tensor([True, False])
    trials.add(ends, passed, torch.tensor([4, 12]))
    save_trials(trials, tmp_path)
    again = load_trials(tmp_path, EDGES, setting="navigator.practised")
    assert torch.equal(again.costs(torch.ones(2)), trials.costs(torch.ones(2)))


def test_those_of_another_map_or_damaged_ones_are_refused(tmp_path: Path) -> None:
    save_trials(EdgeTrials(EDGES), tmp_path)
    for other in (EDGES[:1], EDGES + 1):
        rule = f"n must name a practice on the run's map of {len(other)} edges, got one"
        with pytest.raises(SettingsError, match=rule):
            load_trials(tmp_path, other, setting="n")
    path = tmp_path / TRIALS_FILE
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(SettingsError, match="n must name a complete file, got the dam"):
        load_trials(tmp_path, EDGES, setting="n")
    path.unlink()
    with pytest.raises(SettingsError, match="n must name a run with edge_trials"):
        load_trials(tmp_path, EDGES, setting="n")


@pytest.mark.parametrize("name", ["edges", "tried", "passed", "walked", "lost"])
@pytest.mark.parametrize("kind", OTHER_WEIGHTS)
def test_other_numbers_than_trials_are_refused(
    tmp_path: Path, name: str, kind: str
) -> None:
    trials = EdgeTrials(EDGES)
    trials.add(torch.tensor([[0, 1]]), torch.tensor([True]), torch.tensor([4]))
    save_trials(trials, tmp_path)
    other, said = OTHER_WEIGHTS[kind]
    if kind == "too large":  # their kind is looked at first
        said = "is torch.float64 "
    if name == "edges":
        if kind in ("nan", "whole"):  # which they are
            return
        said = f"{said}|on the run's map of 2 edges, got one of another map, of "
    said = said.replace("NaN or infinity in ", "trials must be finite numbers ")
    said = said.replace("no plain numbers in ", f"{name} is no plain tensor")
    replace(tmp_path / TRIALS_FILE, (name,), other)
    with refusing(f"n must name .*({said})"):
        load_trials(tmp_path, EDGES, setting="n")
