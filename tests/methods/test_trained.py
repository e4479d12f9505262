"""Policies that explore.py has trained play beside navigators."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from tests.explored import RING, Explored, navigate_settings
from tests.exploring import explore_settings, world_of
from toponav import keys
from toponav.builders import make_goal_places, save_policy
from toponav.config import SettingsError
from toponav.methods import LEARNERS
from toponav.methods.navigators import NAVIGATORS, TrainedPolicy, make_policies
from toponav.reports import episode_table, play_policies

#: Of an exploration that trains a rival in the ring.
WORDS = ("reward=extrinsic", "maze.goal=true", "policy.view_size=36")


def train(folder: Path, loss: str, *words: str) -> Path:
    """A run folder with a policy that was never trained."""
    (folder / "config").mkdir(parents=True)
    (folder / "ring.txt").write_text(RING)
    maze = ("maze=file", f"maze.path={folder / 'ring.txt'}")
    config = explore_settings(*maze, *WORDS, f"loss={loss}", *words)
    OmegaConf.save(OmegaConf.structured(config), folder / "config" / "config.yaml")
    torch.manual_seed(3)
    policy = LEARNERS[loss].make_policy(config, world_of(config))
    save_policy(folder, policy.state_dict())
    return folder


@pytest.mark.slow
def test_all_rivals_play_the_episodes_of_the_others(
    folder: Path, explored: Explored, tmp_path: Path
) -> None:
    runs = {loss: train(tmp_path / loss, loss) for loss in ("dqn", "drqn", "nav_a3c")}
    words = [f"{loss}:{run}" for loss, run in runs.items()]
    config = navigate_settings(
        folder,
        "evaluate.policies=[oracle,random]",
        f"evaluate.trained={words}",
        "video.decisions=0",
    )
    places = make_goal_places(config, *explored)
    policies = make_policies(config, *explored)
    assert list(policies) == ["oracle", "random", *runs]
    played = play_policies(config, explored[1], places, policies)
    assert [one.policy for one in played] == list(policies)
    first = played[0].trace
    for one in played[1:]:
        assert (one.trace.positions[:, 0] == first.positions[:, 0]).all()
        assert (one.trace.goal_cells == first.goal_cells).all()
        assert one.map is None
    moved = [one.trace.positions.std() for one in played]
    assert min(moved) > 0
    assert [len(episode_table(one)) for one in played] == [2] * 5
    # Alone, it does what it did beside the others.
    config = navigate_settings(
        folder,
        "navigator=trained",
        f"navigator.policy={runs['nav_a3c']}",
        "evaluate.policies=[navigator]",
        "video.decisions=0",
    )
    policies = make_policies(config, *explored)
    (alone,) = play_policies(config, explored[1], places, policies)
    assert (alone.trace.positions == played[-1].trace.positions).all()


def test_they_get_neither_truth_nor_goal(explored: Explored, tmp_path: Path) -> None:
    for loss in ("dqn", "nav_a3c_d2l"):
        run = train(tmp_path / loss, loss)
        words = ("navigator=trained", f"navigator.policy={run}")
        config = navigate_settings(tmp_path / loss, *words)
        policy = make_policies(config, *explored)["navigator"]
        assert isinstance(policy, TrainedPolicy)
        read = set(policy.in_keys)
        own = {keys.POLICY_PIXELS, keys.IS_INIT, keys.VELOCITY}
        own |= {keys.PREVIOUS_ACTION, keys.PREVIOUS_REWARD}
        own |= {keys.HIDDEN, keys.MEMORY_CELL, keys.FRAMES, keys.ACTION}
        assert read <= own
        assert set(policy.senses) == ({"velocity"} if "nav" in loss else set())
    assert NAVIGATORS["trained"].needs == ("settings",)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["reward.name=coverage"],
            "with reward=extrinsic, so that its policy",
        ),
        (["maze.texture_seed=5"], "maze.texture_seed must be 5, as in the run"),
        (["policy.input=auto", "pretrained=runs/x"], "with policy.input=pixels, got"),
        (["engine=dmlab"], "must name an exploration with engine=vizdoom, got"),
    ],
)
def test_what_does_not_fit_is_refused(
    folder: Path, explored: Explored, tmp_path: Path, words: list[str], message: str
) -> None:
    run = train(tmp_path / "rival", "dqn")
    file = run / "config" / "config.yaml"
    saved = OmegaConf.load(file)
    for word in words:
        key, _, value = word.partition("=")
        OmegaConf.update(saved, key, int(value) if value.isdigit() else value)
    OmegaConf.save(saved, file)
    config = navigate_settings(folder, f"evaluate.trained=[rival:{run}]")
    with pytest.raises(SettingsError, match=message):
        make_policies(config, *explored)


def test_folders_and_names_are_checked(
    folder: Path, explored: Explored, tmp_path: Path
) -> None:
    def refused(*words: str) -> str:
        with pytest.raises(SettingsError) as error:
            make_policies(navigate_settings(folder, *words), *explored)
        return str(error.value)

    rule = "navigator.policy must name the folder of an exploration, got '"
    assert refused("evaluate.trained=[a:nowhere]") == f"{rule}nowhere'"
    run = train(tmp_path / "rival", "dqn")
    (run / "policy.pt").unlink()
    assert "navigator.policy" in refused(f"evaluate.trained=[a:{run}]")
    sentence = refused(f"evaluate.trained=[oracle:{run}]")
    assert sentence == "evaluate.trained must have names of their own, got 'oracle'"
    assert refused("navigator=trained").endswith("exploration, got none")
    with pytest.raises(SettingsError, match="must hold entries such as dqn:runs/explo"):
        navigate_settings(folder, "evaluate.trained=[dqn]")


def test_a_policy_larger_than_its_file_takes_no_memory(
    folder: Path, explored: Explored, tmp_path: Path
) -> None:
    run = train(tmp_path / "rival", "nav_a3c")
    file = run / "config" / "config.yaml"
    saved = OmegaConf.load(file)
    saved.policy.hidden = 16_000  # gigabytes
    OmegaConf.save(saved, file)
    config = navigate_settings(folder, f"evaluate.trained=[rival:{run}]")
    rule = "^navigator.policy must name a policy saved with the same "
    rule += r"settings, got .*policy.pt \(.* is torch.float32 .*, not .*16000"
    with pytest.raises(SettingsError, match=rule):
        make_policies(config, *explored)
