import copy
import csv
import io
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings
from tests.models import WORLD
from toponav.builders import make_networks
from toponav.config import ExploreConfig, SettingsError, TrainingError
from toponav.keys import ACTION, EMBEDDING, TRAJECTORY
from toponav.training import LocomotionFinetuner

SETTINGS = ("locomotion.updates=150", "locomotion.pairs=64", "locomotion.lr=0.01")


def walks(*, start: int = 0, length: int = 32, rows: int = 4) -> TensorDict:
    """Agents on a line: action 0 goes one up, action 1 one down, in turns of eight.

    The embedding is the place, so that the sign of a difference names the action.
    """
    step = torch.arange(start, start + length).expand(rows, -1)
    row = torch.arange(rows).unsqueeze(1)
    action = ((step + 3 * row) // 8) % 2
    place = (1 - 2 * action).cumsum(1) - (1 - 2 * action) + start % 2
    embedding = torch.zeros(rows, length, 8)
    embedding[..., 0] = place
    return TensorDict(
        {
            EMBEDDING: embedding,
            ACTION: action,
            TRAJECTORY: row.expand(-1, length).clone(),
            "step_count": step.unsqueeze(-1).clone(),
        },
        [rows, length],
    )


def nothing(figures: dict[str, float], update: int) -> None:
    pass


def make(
    config: ExploreConfig, check=nothing
) -> tuple[LocomotionFinetuner, torch.nn.Module]:
    torch.manual_seed(0)
    networks = make_networks(config.model, WORLD)
    finetuner = LocomotionFinetuner(config, networks, check)
    return finetuner, networks.locomotion.head


def test_the_head_learns_the_actions_that_were_taken(tmp_path: Path) -> None:
    config = explore_settings(*SETTINGS, "locomotion.k=4")
    finetuner, head = make(config)
    finetuner.extend(walks())
    finetuner.finish(tmp_path)
    here, there = torch.zeros(2, 8), torch.zeros(2, 8)
    there[:, 0] = torch.tensor([2.0, -2.0])
    with torch.no_grad():
        assert head(here, there).argmax(1).tolist() == [0, 1]
    with (tmp_path / "locomotion.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["update"] for row in rows] == ["100", "150"]
    # At a turn the way back is as good: nobody gets all.
    assert float(rows[-1]["accuracy"]) > 0.8
    assert not head.training


@pytest.mark.parametrize("updates", [1, 2, 3, 4, 9, 10, 11, 20])
def test_any_number_of_updates_is_made(tmp_path: Path, updates: int) -> None:
    # A tenth of 10 is one update, in which a learning rate cannot rise.
    words = (*SETTINGS, "locomotion.k=4", f"locomotion.updates={updates}")
    finetuner, head = make(explore_settings(*words))
    before = copy.deepcopy(head.state_dict())
    finetuner.extend(walks())
    finetuner.finish(tmp_path)
    with (tmp_path / "locomotion.csv").open() as file:
        assert [row["update"] for row in csv.DictReader(file)] == [str(updates)]
    found = head.state_dict()
    assert any(not torch.equal(before[name], one) for name, one in found.items())


def test_weights_of_the_head_decay_as_its_settings_say(tmp_path: Path) -> None:
    sizes = []
    for decay in (0.0, 10.0):
        decayed = f"locomotion.weight_decay={decay}"
        finetuner, head = make(explore_settings(*SETTINGS, "locomotion.k=4", decayed))
        finetuner.extend(walks())
        finetuner.finish(tmp_path)
        sizes.append(sum(float(weight.detach().norm()) for weight in head.parameters()))
    # 150 updates of a rate up to 0.01 shrink weights by up to a tenth each.
    assert sizes[1] < sizes[0] / 2


def test_the_encoder_stays_as_it_is(tmp_path: Path) -> None:
    config = explore_settings(*SETTINGS, "locomotion.k=4")
    networks = make_networks(config.model, WORLD)
    before = copy.deepcopy(networks.tc.state_dict())
    finetuner = LocomotionFinetuner(config, networks, nothing)
    finetuner.extend(walks())
    finetuner.finish(tmp_path)
    for name, value in networks.tc.state_dict().items():
        assert torch.equal(value, before[name]), name


def test_a_resumed_run_learns_the_same(tmp_path: Path) -> None:
    # A memory of 200 decisions wraps around, and some of the first 128 stay.
    config = explore_settings(*SETTINGS, "locomotion.k=4", "locomotion.memory=200")
    (whole, one), (cut, _), (resumed, other) = (make(config) for _ in range(3))
    for finetuner in (whole, cut):
        finetuner.extend(walks())
    resumed.load_state_dict(copy.deepcopy(cut.state_dict()))
    # A resumed run starts new episodes, and numbers them from 0 again.
    later = walks()
    resumed.extend(later)
    later[TRAJECTORY] = later[TRAJECTORY] + 4
    whole.extend(later)
    for finetuner in (whole, resumed):
        finetuner.finish(tmp_path)
    for mine, theirs in zip(one.parameters(), other.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_a_checkpoint_holds_what_was_seen_and_no_empty_memory() -> None:
    config = explore_settings(*SETTINGS, "locomotion.memory=100000")
    finetuner, _ = make(config)
    finetuner.extend(walks())
    file = io.BytesIO()
    torch.save(finetuner.state_dict(), file)
    # 128 decisions of 40 bytes, and a head of 1.1 MB; the empty memory is 4 MB.
    assert file.tell() < 1_200_000
    resumed, _ = make(config)
    file.seek(0)
    resumed.load_state_dict(torch.load(file, weights_only=True))
    assert (resumed.buffer.storage[:] == finetuner.buffer.storage[:]).all()


def test_the_memory_of_an_earlier_run_is_read() -> None:
    config = explore_settings(*SETTINGS)
    (finetuner, _), (resumed, _) = make(config), make(config)
    finetuner.extend(walks())
    state = finetuner.state_dict()
    earlier = {"head": state["head"], "generator": state["generator"]}
    resumed.load_state_dict(earlier | {"buffer": finetuner.buffer.state_dict()})
    assert (resumed.buffer.storage[:] == finetuner.buffer.storage[:]).all()


def test_a_run_that_is_resumed_after_it_learned_learns_no_more_than_once(
    tmp_path: Path,
) -> None:
    config = explore_settings(*SETTINGS)
    finetuner, head = make(config)
    finetuner.extend(walks())
    state = copy.deepcopy(finetuner.state_dict())
    finetuner.finish(tmp_path)
    # What was learned is in the run's networks, with which a resumed run begins.
    again, second = make(config)
    second.load_state_dict(head.state_dict())
    again.load_state_dict(state)
    again.finish(tmp_path)
    for one, other in zip(head.parameters(), second.parameters(), strict=True):
        assert torch.equal(one, other)


def test_a_loss_that_is_no_number_is_told(tmp_path: Path) -> None:
    def check(figures: dict[str, float], update: int) -> None:
        if figures["loss_locomotion"] != figures["loss_locomotion"]:
            raise TrainingError(f"update {update}")

    finetuner, _ = make(explore_settings(*SETTINGS, "locomotion.k=4"), check)
    broken = walks()
    broken[EMBEDDING] = broken[EMBEDDING] * float("nan")
    finetuner.extend(broken)
    with pytest.raises(TrainingError, match="update 1"):
        finetuner.finish(tmp_path)


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"locomotion\.k must be less than"):
        explore_settings("locomotion.k=64")
    # 96 decisions of 4 mazes, cut once: 12 of each; M * k is 12.
    words = ("online.learn=true", "online.ahead=96", "pairs.k=4", "pairs.m=3")
    rule = r"online\.ahead / \(2 \* collect\.envs\) must be more than .* 12"
    with pytest.raises(SettingsError, match=rule):
        explore_settings(*words)
    explore_settings(*words, "online.ahead=104")


def test_without_long_episodes_the_head_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finetuner, head = make(explore_settings(*SETTINGS, "locomotion.k=32"))
    before = copy.deepcopy(head.state_dict())
    finetuner.extend(walks(length=32))
    finetuner.finish(tmp_path)
    # A pair 32 decisions apart needs 33.
    assert "must hold an episode of at least 33 decisions" in capsys.readouterr().out
    assert all(
        torch.equal(before[name], one) for name, one in head.state_dict().items()
    )
    assert not (tmp_path / "locomotion.csv").exists()
