"""What a run with ``device=cuda`` does, on a stand-in device and on a GPU.

On the stand-in device operations on tensors of two devices are refused, as on a GPU.
"""

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from tests.conftest import DEVICES
from tests.exploring import explore_settings, make_batch, save_untrained, world_of
from tests.forked import run_forked
from tests.methods import test_nav_a3c, test_q_learners
from tests.models import tiny_model
from tests.stand_in_device import NAME, HostWaits, StandInDevice
from tests.stand_in_workers import stand_in_workers
from tests.training.pair_storage import WORLD, make_trainer, make_walks, pair_settings
from tests.training.test_continued_training import CONFIG
from tests.training.test_locomotion import SETTINGS, walks
from tests.training.test_map_growth import (
    learn_quickly,
    make_pose_growth,
    through_the_ring,
)
from tests.transforms.colour_world import reset, step
from tests.transforms.test_waypoint_truth import at
from toponav.builders import PLACES_FILE, load_places, make_networks
from toponav.methods import LEARNERS
from toponav.training import ContinuedTraining, LocomotionFinetuner
from toponav.transforms import WaypointTruth

ROOT = Path(__file__).parent.parent


def same(one: nn.Module, other: nn.Module) -> bool:
    others = other.state_dict()
    return all(
        torch.equal(tensor.cpu(), others[name].cpu())
        for name, tensor in one.state_dict().items()
    )


@pytest.mark.parametrize("share_encoder", [True, False])
@pytest.mark.parametrize("mined", [True, False])
def test_pairs_train_networks_there(
    device: str, mined: bool, share_encoder: bool
) -> None:
    networks, trainer = make_trainer(
        mined=mined, share_encoder=share_encoder, device=device
    )
    measured = trainer.step()
    _, here = make_trainer(mined=mined, share_encoder=share_encoder)
    assert measured == pytest.approx(here.step(), rel=1e-3)
    assert str(networks.device).startswith(device)


def test_the_papers_encoder_trains_there(device: str) -> None:
    networks, trainer = make_trainer(encoder="resnet18", device=device)
    measured = trainer.step()
    _, here = make_trainer(encoder="resnet18")
    expected = here.step()
    # Through twenty normalisations of few views rounding grows: 0.25 % on an H200.
    norm = expected.pop("gradient_norm")
    assert measured.pop("gradient_norm") == pytest.approx(norm, rel=1e-2)
    assert measured == pytest.approx(expected, rel=1e-3)
    assert str(networks.device).startswith(device)


def test_a_trainer_continues_there(device: str) -> None:
    (_, one), (_, other) = make_trainer(device=device), make_trainer(device=device)
    one.step()
    other.load_state_dict(one.state_dict())
    assert other.step() == pytest.approx(one.step(), rel=1e-3)


def test_continued_training_hands_weights_over_when_a_version_is_due(
    device: str,
) -> None:
    torch.manual_seed(0)
    networks = make_networks(tiny_model(), WORLD)
    settings = replace(
        explore_settings(f"device={device}"), online=CONFIG, pairs=pair_settings()
    )
    training = ContinuedTraining(settings, networks, lambda figures, update: None)
    # 60 decisions a batch; a version is due after 150.
    for number in range(3):
        before = {name: one.clone() for name, one in networks.tc.state_dict().items()}
        training.extend(make_walks(episodes=2, first=2 * number))
        due = bool(training.updated())
        changed = any(
            not torch.equal(one, before[name])
            for name, one in networks.tc.state_dict().items()
        )
        assert due == changed == (number == 2)
    assert str(networks.device) == "cpu"
    assert str(next(training.trainer.network.parameters()).device).startswith(device)
    assert same(training.trainer.network, networks.modules)


#: TRPO's loops, each once or twice.
SHORT_LOOPS = ("rollout=16", "cg_iterations=2", "critic_epochs=1")


@pytest.mark.parametrize("loss", ["ppo", "a3c", "trpo"])
def test_learners_learn_there(device: str, loss: str) -> None:
    few = [f"loss.{word}" for word in SHORT_LOOPS] if loss == "trpo" else []
    settings = explore_settings(f"device={device}", f"loss={loss}", *few)
    learner = LEARNERS[loss](
        settings,
        world_of(settings),
        reward="intrinsic_reward",
        check=lambda figures, update: None,
        progress=lambda: 0.5,
    )
    measured = learner.extend(make_batch(settings))
    assert all(value == value for value in measured.values())
    assert str(next(learner.policy.parameters()).device).startswith(device)


def test_an_update_waits_little_for_the_device() -> None:
    def waits(epochs: int) -> Counter[str]:
        words = ("loss=ppo", "loss.minibatches=1", f"loss.epochs={epochs}")
        settings = explore_settings(f"device={NAME}", *words)
        learner = LEARNERS["ppo"](
            settings,
            world_of(settings),
            reward="intrinsic_reward",
            check=lambda figures, update: None,
            progress=lambda: 0.5,
        )
        with HostWaits() as found:
            learner.extend(make_batch(settings))
        return Counter(found.names)

    with StandInDevice():
        more = waits(2)
        more.subtract(waits(1))
    # Four numbers: whether actions and hidden states are as they must be, one of
    # TorchRL's loss, the gradient's norm. Where episodes begin; a list of all losses.
    # One copy, for all minibatches of a pass: their order, drawn on the processor.
    assert +more == {
        "aten._local_scalar_dense": 4,
        "aten.nonzero": 1,
        "tolist": 1,
        "aten._to_copy": 1,
    }


@pytest.mark.parametrize("loss", ["dqn", "drqn", "nav_a3c", "nav_a3c_d2l"])
def test_rivals_that_navigate_learn_there(device: str, loss: str) -> None:
    rivals = test_q_learners if loss in ("dqn", "drqn") else test_nav_a3c
    learner = rivals.make_learner(loss, f"device={device}")
    if rivals is test_q_learners:
        batch = rivals.make_batch()
    else:
        batch = rivals.make_batch(rivals.make_learner(loss).policy)
    measured = learner.extend(batch)
    assert measured
    assert all(value == value for value in measured.values())
    assert str(next(learner.policy.parameters()).device).startswith(device)


def test_the_head_of_the_l_network_is_trained_there(
    device: str, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    settings = explore_settings(f"device={device}", *SETTINGS, "locomotion.updates=3")
    networks = make_networks(settings.model, world_of(settings).spec)
    finetuner = LocomotionFinetuner(settings, networks, lambda figures, update: None)
    before = [one.clone() for one in networks.locomotion.head.parameters()]
    finetuner.extend(walks())
    finetuner.finish(tmp_path)
    after = list(networks.locomotion.head.parameters())
    assert not any(map(torch.equal, before, after))
    assert all(str(one.device) == "cpu" for one in after)


def test_a_map_by_poses_and_its_places_are_made_there(
    device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learn_quickly(monkeypatch, rounds=1, updates=20)
    config, growth = make_pose_growth(tmp_path, f"device={device}")
    for env in range(2):
        through_the_ring(config, growth, env=env)
    many = growth.map.num_waypoints
    growth.finish(tmp_path)
    number, size = growth.map.embeddings.shape
    assert 1 < number < many
    sizes = {"num_places": number, "embedding_size": size}
    assert load_places(tmp_path / PLACES_FILE, **sizes, setting="run")


def test_the_truth_about_waypoints_stays_small_there(device: str) -> None:
    truth, long = WaypointTruth(96.0), 30
    for _ in range(10):
        for decision in range(long):
            pose = at((decision * 90, 0, 0), is_new_waypoint=decision % 10 == 0)
            (reset if decision == 0 else step)(truth, pose.to(device))
    # Three waypoints an episode, ten episodes: there are eight slots at the least.
    assert truth.poses.shape[1] == 8


def run_there(name: str, recipe: str, *overrides: str) -> None:
    """A recipe with ``device=<name>``, to its end."""
    if name == NAME and recipe == "explore":
        done = run_forked(recipe, *overrides, inside=stand_in_workers())
    else:
        script = [str(ROOT / "tests/stand_in_device.py")] if name == NAME else []
        done = subprocess.run(
            [sys.executable, *script, f"{ROOT}/recipes/{recipe}.py", *overrides],
            capture_output=True,
            text=True,
            timeout=280,
            check=False,
        )
    assert done.returncode == 0, done.stderr


def small(name: str) -> tuple[str, ...]:
    return "scale=smoke", f"device={name}", "model.embedding_dim=8"


def exploring(name: str, tmp_path: Path) -> tuple[str, ...]:
    """Of a short exploration by networks that were never trained."""
    networks = tmp_path / "networks.pt"
    save_untrained(networks)
    return (
        *small(name),
        f"pretrained={networks}",
        "policy.hidden=16",
        "maze.episode_length=32",
        "evaluate.episodes=1",
        "evaluate.random_episodes=1",
        f"evaluate.random_folder={tmp_path}/baselines",
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES)
def test_pretraining_runs_there(name: str, tmp_path: Path) -> None:
    """One, a resume of it, and another one from its networks."""
    words = (*small(name), "train.updates=2", "train.warmup=1", "collect.decisions=512")
    words += ("validate.decisions=60", "validate.every=2", "validate.pairs=20")
    networks = tmp_path / "networks"
    run_there(name, "pretrain", *words, f"hydra.run.dir={networks}")
    run_there(name, "pretrain", f"resume={networks}", "train.updates=3")
    other = (f"init_from={networks}", f"hydra.run.dir={tmp_path}/other")
    run_there(name, "pretrain", *words, *other)


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES)
def test_exploring_runs_there_with_all_that_trains(name: str, tmp_path: Path) -> None:
    """And a resume of it."""
    run_there(
        name,
        "explore",
        *exploring(name, tmp_path),
        "policy.input=pixels",
        "loss=a3c",
        "collect.decisions=512",
        "locomotion.updates=3",
        "online.learn=true",
        "online.ahead=256",
        "online.every=256",
        "online.publish_every=256",
        f"hydra.run.dir={tmp_path}/run",
    )
    run_there(name, "explore", f"resume={tmp_path}/run")


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES)
def test_exploring_runs_there_by_the_default(name: str, tmp_path: Path) -> None:
    words = ("map.poses=true", "collect.decisions=256")
    folder = f"hydra.run.dir={tmp_path}/default"
    run_there(name, "explore", *exploring(name, tmp_path), *words, folder)
    assert (tmp_path / "default" / "map.zip").is_file()
