"""A checkpoint whose checksums fit and whose content does not is refused, unused."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.envs import fake_engine
from tests.exploring import explore_settings, world_of
from tests.training.test_resumed_collecting import SMALL, batches, make_collector
from toponav.builders import Consumer, make_networks
from toponav.collectors import Mailbox
from toponav.config import ExploreConfig, SettingsError
from toponav.envs import ENGINES
from toponav.methods import make_reward
from toponav.training import (
    ExplorationState,
    Explorer,
    make_consumers,
    make_learner,
    needed_keys,
    publish,
    restore_exploration,
    save_exploration,
)

WORDS = (*SMALL, "reward.threshold=0.5")


def make_run(
    config: ExploreConfig, folder: Path
) -> tuple[Explorer, ExplorationState, dict[str, Consumer]]:
    """All that a run restores, as it is at its start."""
    torch.manual_seed(0)
    world, state = world_of(config), ExplorationState()
    networks = make_networks(config.model, world.spec)
    networks.modules.eval()
    networks.thresholds = {"tc_threshold": 0.9, "tc_reach": 0.7}
    reward = make_reward(config, world, networks)
    learner = make_learner(config, world, reward, state, folder)
    explorer = Explorer(learner.policy, reward, networks)
    given = config, world, networks, learner, reward, state, folder
    return explorer, state, make_consumers(*given)[1]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run of three batches, which end within an episode of 64 decisions."""
    folder, config = tmp_path_factory.mktemp("run"), explore_settings(*WORDS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ENGINES, "fake", "tests.envs.fake_engine")
        explorer, state, consumers = make_run(config, folder)
        mailbox = Mailbox(explorer.modules())
        collector = make_collector(config, mailbox, keep=needed_keys(consumers))
        for batch in batches(collector, 6):
            state.count(batch.numel(), 1.0, config.collect)
            for consumer in consumers.values():
                consumer.extend(batch)
            state.versions |= publish(mailbox, explorer, consumers.values())
            state.history.append({"decisions": state.decisions, "coverage": 0.5})
            state.measured["lr"] = [0.5]
        growth: Any = consumers["map"]
        growth.rows.append({"decisions": 64, "coverage": 0.5})
        save_exploration(folder, state, consumers, [collector.running_episodes()])
        collector.shutdown()
        yield folder
    fake_engine.GAMES.clear()


def content(run: Path) -> dict[str, Any]:
    found: dict[str, Any] = torch.load(run / "checkpoint.pt", weights_only=True)
    return found


@pytest.fixture
def damaged(run: Path, tmp_path: Path) -> Path:
    """Another folder with the same, to be damaged."""
    for path in run.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def put(found: Any, place: tuple[Any, ...], value: object) -> None:
    for key in place[:-1]:
        found = found[key]
    found[place[-1]] = value


def refusal(folder: Path, state: dict[str, Any]) -> str:
    """What a resume says to this state, which writes nothing."""
    torch.save(state, folder / "checkpoint.pt")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    config = explore_settings(*WORDS)
    _, fresh, consumers = make_run(config, folder)
    with pytest.raises(SettingsError) as caught:
        restore_exploration(folder, fresh, consumers)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_was_not_damaged_is_restored(run: Path) -> None:
    config = explore_settings(*WORDS)
    _, state, consumers = make_run(config, run)
    episodes = restore_exploration(run, state, consumers)
    assert state.decisions == 384
    assert episodes is not None
    assert len(episodes) == 1


#: Where something else stands, what it is, and what is said of it.
DAMAGE = [
    (
        ("state", "decisions"),
        "x",
        "decisions must be of type int, and not negative, got x",
    ),
    (
        ("state", "decisions"),
        -5,
        "decisions must be of type int, and not negative, got -5",
    ),
    (("state", "decisions"), 3, "one number of decisions, got 3 by the run, 384"),
    (("state", "seconds"), float("nan"), "seconds must be of type float"),
    (("state", "history"), 1, "history must be of type list"),
    (("consumers", "map", "truth"), None, ""),
    (("torch_generator",), torch.zeros(3), "RNG state"),
]


@pytest.mark.parametrize(("place", "value", "said"), DAMAGE)
def test_what_a_run_does_not_write_is_refused(
    run: Path, damaged: Path, place: tuple[Any, ...], value: object, said: str
) -> None:
    state = content(run)
    put(state, place, value)
    found = refusal(damaged, state)
    start = "resume must name an exploration saved with the same settings, got "
    assert found.startswith(f"{start}{damaged / 'checkpoint.pt'} (")
    assert said[:60] in found
