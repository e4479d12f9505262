"""The tasks of `sanity_navigation`: who learns what, and by which settings.

In ``catch`` all that matters is in view; in ``goal``, MiniGrid's Empty-Random-5x5, it
comes into view by turning. ``recall`` and ``match`` need a memory. In ``match``,
MiniGrid's MemoryS7, an object says which way to turn at the end of a corridor, and
with views of 3 x 3 squares that end is at least six decisions from where it is seen:
more than DQN's four views show, less than DRQN's ten. In ``maze``, a small one on the
engine, the goal never moves.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from sanity_games import SIDE, Catch, Game, GameWorld, Recall

from toponav.builders import make_env
from toponav.config import ExploreConfig
from toponav.launch import folder_name
from toponav.methods import make_world, register
from toponav.methods.worlds import MazeWorld

CONF = Path(__file__).parent.parent / "conf"
GAMES: dict[str, type[Game]] = {"catch": Catch, "recall": Recall}


@dataclass(frozen=True, kw_only=True)
class Task:
    """Who learns what for how long, and how it is judged."""

    learners: tuple[str, ...]
    decisions: int
    every: int  # decisions of a row
    length: int  # decisions of a test, which has whole episodes
    random_envs: int  # environments in which random actions are judged
    settings: tuple[str, ...]


#: Settings of the value learners.
VALUES = ("collect.envs=16", "policy.hidden=64", "loss.reward_scale=1")
VALUES += ("loss.rollout=20", "loss.replay=10000", "loss.warmup=1000", "loss.every=4")
VALUES += ("loss.target_every=200", "loss.lr=0.0005", "loss.epsilon_until=0.4")
#: Settings of the rooms: turns and steps alone.
ROOMS = ("world=gym", "world.actions=[0,1,2]")
ROOMS += ("world.wrappers=[minigrid.wrappers.RGBImgPartialObsWrapper]",)
TASKS = {
    "catch": Task(
        learners=("dqn", "drqn"),
        decisions=12_800,
        every=1_280,
        length=9,
        random_envs=512,
        settings=VALUES,
    ),
    "recall": Task(
        learners=("dqn", "drqn"),
        decisions=15_360,
        every=1_280,
        length=9,
        random_envs=512,
        settings=VALUES,
    ),
    "goal": Task(
        learners=("dqn", "drqn"),
        decisions=16_000,
        every=1_600,
        length=30,
        random_envs=64,
        settings=(
            *VALUES,
            *ROOMS,
            "world.id=MiniGrid-Empty-Random-5x5-v0",
            "world.options=[max_steps:30,agent_view_size:5]",
            "world.episode_length=30",
            # With larger steps, or where a step nearer is worth only a hundredth, it is
            # learned and forgotten again.
            *("loss.lr=2.5e-4", "loss.final_lr=0.02", "loss.eps=1.5e-4"),
            *("loss.target_every=500", "loss.gamma=0.9"),
        ),
    ),
    "match": Task(
        learners=("dqn", "drqn"),
        decisions=25_600,
        every=2_560,
        length=50,
        random_envs=64,
        settings=(
            *VALUES,
            *ROOMS,
            "world.id=MiniGrid-MemoryS7-v0",
            "world.options=[max_steps:50,agent_view_size:3]",
            "loss.every=8",
            "world.episode_length=50",
        ),
    ),
    "maze": Task(
        learners=("nav_a3c", "nav_a3c_d2l"),
        decisions=128_000,
        every=12_800,
        length=400,
        random_envs=16,
        settings=(
            *("collect.envs=16", "maze=random", "maze.rows=2", "maze.cols=2"),
            *("maze.loops=1", "maze.goal=true", "maze.episode_length=400"),
            *("policy.hidden=128", "loss.rollout=20", "loss.first_hidden=32"),
            # With goals worth 10, and a critic that weighs more, the codes of all views
            # come to be much the same, and no head learns from them.
            *("loss.normalize_returns=true", "loss.critic_coeff=0.1"),
            *("loss.lr=5e-4", "loss.eps=1e-5", "loss.entropy_coeff=0.01"),
        ),
    ),
}


class FixedGoal(MazeWorld):
    """A maze whose goal is in the same cell in all episodes."""

    def make_env(self, *, senses=(), privileged=False, batch_size, seed, **_: object):
        assert self.layout is not None
        return make_env(
            self.maze,
            engine=self.engine,
            batch_size=batch_size,
            seed=seed,
            privileged=privileged,
            goal_cells=[self.layout.cells[-1]],
            depth=(20, 18) if "depth" in senses else None,
            velocity="velocity" in senses,
        )


def settings_of(task: str, loss: str, seed: int) -> ExploreConfig:
    """The settings of one run."""
    register()
    OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)
    words = ["reward=extrinsic", "policy.input=pixels", f"policy.view_size={SIDE}"]
    words += [f"seed={seed}", "collect.workers=1", "evaluate.episodes=1"]
    words += [f"loss={loss}", *TASKS[task].settings]
    if loss == "drqn":
        # An update has 16 slices of ten decisions, where DQN's has 32 stacks; half as
        # many updates take about as long.
        every = 16 if task == "match" else 8
        words += ["loss.batch=16", f"loss.every={every}"]
        # As many decisions between two target networks as for DQN.
        words += [f"loss.target_every={250 if task == 'goal' else 100}"]
        # With DQN's eps it learns the way to the goal more slowly.
        words += ["loss.eps=1e-6"] if task == "goal" else []
    with initialize_config_dir(str(CONF.resolve()), version_base="1.3"):
        found: Any = OmegaConf.to_object(compose("explore", overrides=words))
    assert isinstance(found, ExploreConfig)
    return found.resolved(None)


def world_of(task: str, settings: ExploreConfig) -> Any:
    """Where the task is."""
    if task in GAMES:
        return GameWorld(GAMES[task])
    return FixedGoal(settings) if task == "maze" else make_world(settings)
