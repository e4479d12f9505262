"""A process beside the run, and the evaluation that it plays."""

import math
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch

from tests.exploring import explore_settings, world_of
from tests.stand_in_device import NAME
from tests.stand_in_workers import evaluate_there
from tests.test_foreign_world import WORLD
from tests.training.test_collecting_on_a_device import require_here
from toponav.builders import Learner, World, make_networks
from toponav.config import ExploreConfig
from toponav.methods import make_reward
from toponav.reports import (
    beside,
    evaluate_policies,
    evaluating,
    evaluation_beside,
)
from toponav.reports.beside import Beside, BesideError
from toponav.training import ExplorationState, Explorer, make_learner, trained_policies


def make_learner_of(
    config: ExploreConfig, world: World, folder: Path
) -> tuple[Learner, Explorer]:
    """With networks that were never trained, if the reward needs some."""
    networks = None
    if config.reward.name == "novelty":
        networks = make_networks(config.model, world.spec)
        networks.modules.eval()
        networks.thresholds = {"reward_threshold": 0.5}
    reward = make_reward(config, world, networks)
    learner = make_learner(config, world, reward, ExplorationState(), folder)
    return learner, Explorer(learner.policy, reward, networks)


def make_explorer_of(config: ExploreConfig, world: World, folder: Path) -> Explorer:
    return make_learner_of(config, world, folder)[1]


def test_close_ends_it_and_it_ends_with_the_object() -> None:
    closed, freed = Beside(math.sqrt, 2.0), Beside(math.sqrt, 2.0)
    processes = closed.process, freed.process
    assert closed.is_running
    closed.close()
    closed.close()
    del freed
    assert [one.returncode for one in processes] == [-15, -15]
    with pytest.raises(BesideError, match="exit status -15"):
        closed.result()


def test_one_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "IDLE_S", 1.2)
    stopped = Beside(math.sqrt, 2.0)
    stopped.process.send_signal(signal.SIGSTOP)
    with pytest.raises(BesideError, match=r"^no processor time in 1.2 s$"):
        stopped.result()
    assert stopped.process.returncode == -signal.SIGKILL


def test_what_cannot_be_pickled_is_said_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("subprocess.Popen", None)
    with pytest.raises(BesideError, match="lock"):
        Beside(math.sqrt, threading.Lock())


def evaluate_here(monkeypatch: pytest.MonkeyPatch, *words: str, after: Any) -> Mock:
    """Evaluate with a stand-in for the evaluation in this process."""
    config, here = explore_settings("reward=random", *words), Mock()
    world = world_of(config)
    monkeypatch.setattr(evaluation_beside, "evaluate_policies", here)
    explorer = make_explorer_of(config, world, Path())
    here.return_value = [Mock()]
    policies = {"last": explorer.policy}
    with evaluating(config, world, explorer, policies) as evaluation:
        after(evaluation.besides.get("last"))
        assert evaluation.result() == here.return_value
    return here


def test_few_episodes_are_played_by_the_run_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found: list[object] = []
    evaluate_here(monkeypatch, after=found.append)
    assert found == [None]


def kill(beside: Beside[Any]) -> None:
    beside.process.kill()


def unpicklable(monkeypatch: pytest.MonkeyPatch) -> Callable[[object], None]:
    monkeypatch.setattr(evaluation_beside, "_evaluate", lambda: None)
    return lambda _: None


@pytest.mark.parametrize(
    ("failing", "reason"), [(kill, "exit status -9"), (unpicklable, "lambda")]
)
def test_a_process_that_fails_costs_a_sentence(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    failing: Callable[..., Any],
    reason: str,
) -> None:
    monkeypatch.setattr(evaluation_beside, "FEW", 0)
    after = failing(monkeypatch) if failing is unpicklable else failing
    here = evaluate_here(monkeypatch, after=after)
    here.assert_called_once()
    said = capsys.readouterr().out.strip()
    assert said.startswith("policy last must be evaluated beside the run, got: ")
    assert reason in said
    assert said.endswith("; it is evaluated now")
    assert len(said.splitlines()) == 1


def test_an_error_of_the_block_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation_beside, "FEW", 0)
    started = []  # the object itself, which would end it when it is freed

    def fail(beside: Beside[Any]) -> None:
        started.append(beside)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate_here(monkeypatch, after=fail)
    assert [one.process.returncode for one in started] == [-15]


@pytest.mark.slow
def test_another_process_plays_the_same_episodes(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = explore_settings("seed=3")
    world = world_of(config)
    torch.manual_seed(3)
    explorer = make_explorer_of(config, world, tmp_path)
    policies = {name: explorer.policy for name in ("best", "last")}
    # Small weights choose almost at random: another policy would do as well.
    for weights in explorer.policy.parameters():
        weights.data.mul_(20)
    here = evaluate_policies(config, world, explorer, policies)
    assert capsys.readouterr().err.count("evaluate best") > 0
    monkeypatch.setattr(evaluation_beside, "FEW", 0)
    monkeypatch.setattr(evaluation_beside, "evaluate_policies", None)  # not here, then
    shares = list[float]()
    with evaluating(
        config, world, explorer, policies, show=shares.append
    ) as evaluation:
        torch.rand(5)
        there = evaluation.result()
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert list(evaluation.besides) == ["best", "last"]
    assert "evaluate best, last: 100%" in capsys.readouterr().err
    for one, other in zip(here, there, strict=True):
        assert one.rows() == other.rows()
        assert (one.policy, one.reward_key) == (other.policy, other.reward_key)
        assert torch.equal(one.views, other.views)
        assert (one.episodes == other.episodes).all()
    assert len({row["coverage"] for row in here[0].rows()}) > 1


@pytest.mark.slow
def test_policies_of_a_device_are_evaluated_beside_on_the_processor(
    device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = ("world.episode_length=16", "evaluate.episodes=2")
    config = explore_settings(*WORLD, *small, f"device={device}")
    world = world_of(config)
    torch.manual_seed(3)
    learner, explorer = make_learner_of(config, world, tmp_path)
    assert str(next(learner.policy.parameters()).device).startswith(device)
    # Another process needs no device to read copies.
    require_here(evaluation_beside._copy(learner.policy))
    policies = trained_policies(config, world, learner, {})
    # Small weights choose almost at random: another policy would do as well.
    for weights in policies["last"].parameters():
        weights.data.mul_(20)
    here = evaluate_policies(config, world, explorer, policies)
    # Two episodes of 16 decisions: by themselves they would be too few.
    monkeypatch.setattr(evaluation_beside, "FEW", 2 * 16)
    monkeypatch.setattr(evaluation_beside, "evaluate_policies", None)  # not here, then
    if device == NAME:
        monkeypatch.setattr(evaluation_beside, "_evaluate", evaluate_there)
    with evaluating(config, world, explorer, policies) as evaluation:
        there = evaluation.result()
    assert list(evaluation.besides) == ["last"]
    assert [one.policy for one in there] == ["last"]
    for one, other in zip(here, there, strict=True):
        assert one.rows() == other.rows()
        assert torch.equal(one.views, other.views)
        assert (one.episodes == other.episodes).all()
