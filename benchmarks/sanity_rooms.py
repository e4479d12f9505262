"""ICM and RND in four rooms behind closed doors, beside PPO with the task's reward.

    PYTHONPATH=. python benchmarks/sanity_rooms.py --out results/sanity_rooms.csv

MiniGrid's MultiRoom-N4-S5, always the same rooms and start, 80 decisions an episode;
the agent sees a picture of the 7 x 7 squares before it, turns, walks and opens doors.
The parts are those of ``recipes/explore.py world=gym``: PPO with its memory, rewarded
by ``reward=icm``, ``rnd`` or ``extrinsic``, which pays at the goal in the fourth room.
A row is 12,800 decisions: the share of the episodes that ended in them which had
entered the fourth room, the mean number of the last room that episodes came to, and the
mean reward of decisions in each room over that of all.
"""

import argparse
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import gymnasium
import minigrid
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from sanity_curves import CurveTable
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector

from toponav.config import ExploreConfig
from toponav.keys import POSITION
from toponav.launch import folder_name
from toponav.methods import LEARNERS, make_reward, make_world, register
from toponav.training import Explorer, make_explore_env

CONF = Path(__file__).resolve().parent.parent / "conf"
WORLD, LAYOUT, NUM_ROOMS = "MiniGrid-MultiRoom-N4-S5-v1", 0, 4
ENVS, ROLLOUT, BATCHES_OF_A_ROW = 16, 80, 10
SETTINGS = (
    "world=gym",
    f"world.id={WORLD}",
    "world.wrappers=[minigrid.wrappers.RGBImgPartialObsWrapper]",
    "world.actions=[0,1,2,5]",
    "world.position=[agent_pos.0,agent_pos.1]",
    f"world.reset_seed={LAYOUT}",
    "world.episode_length=80",
    # What the wrapper shows, eight pixels a square.
    "policy.view_size=56",
    "policy.hidden=64",
    f"collect.envs={ENVS}",
    f"loss.rollout={ROLLOUT}",
    "loss.lr=1e-3",
    "loss.final_lr=1.0",
    "loss.final_entropy=1.0",
)
#: Settings of each method: few decisions, so that all of them train the networks.
METHODS = {
    "ppo": ("reward=extrinsic",),
    "icm": ("reward=icm", "reward.lr=1e-3", "reward.update_fraction=1.0"),
    "rnd": ("reward=rnd", "reward.lr=1e-3", "reward.update_fraction=1.0"),
}


def make_settings(method: str, seed: int) -> ExploreConfig:
    """Those of an exploration with this method."""
    register()
    OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)
    words = [*SETTINGS, *METHODS[method], f"seed={seed}"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("explore", overrides=words))
    assert isinstance(settings, ExploreConfig)
    return settings.resolved(None)


class Rooms:
    """In which room a position is: 1 to 4, the door being of the room before it."""

    def __init__(self) -> None:
        assert minigrid is not None
        env = gymnasium.make(WORLD)
        env.reset(seed=LAYOUT)
        rooms = env.unwrapped.rooms
        self.first = torch.tensor([room.top for room in rooms]) + 1
        self.last = self.first - 3 + torch.tensor([room.size for room in rooms])
        env.close()

    def number(self, position: Tensor) -> Tensor:
        """``[*B, 2]`` to ``[*B]``; 0 in a door."""
        at = position.unsqueeze(-2)
        inside = ((at >= self.first) & (at <= self.last)).all(-1)
        return (inside * torch.arange(1, NUM_ROOMS + 1)).amax(-1)


def explore(method: str, seed: int, decisions: int) -> Iterator[tuple[object, ...]]:
    """Learn with one method; rows of decisions and measures."""
    torch.manual_seed(seed)
    settings, rooms, progress = make_settings(method, seed), Rooms(), [0.0]
    world = make_world(settings)
    reward = make_reward(settings, world, None)
    learner = LEARNERS["ppo"](
        settings,
        world,
        reward=reward.reward_key,
        check=lambda figures, update: None,
        progress=lambda: progress[0],
    )
    explorer = Explorer(learner.policy, reward, None)
    env = make_explore_env(settings, world, explorer, envs=ENVS, seed=seed)
    collector = Collector(
        env, learner.policy, frames_per_batch=ENVS * ROLLOUT, total_frames=-1
    )
    deepest = torch.ones(ENVS, dtype=torch.int64)
    ended: list[int] = []
    bonus, visits = torch.zeros(NUM_ROOMS + 1), torch.zeros(NUM_ROOMS + 1)
    for number, batch in enumerate(collector, start=1):
        progress[0] = number * batch.numel() / decisions
        room = rooms.number(batch["next", POSITION])
        deepest, over = _follow(batch, room, deepest)
        ended += over
        pay = batch["next", reward.reward_key].flatten()
        bonus.index_add_(0, room.flatten(), pay)
        visits += torch.bincount(room.flatten(), minlength=NUM_ROOMS + 1)
        learner.extend(batch)
        reward.extend(batch)
        if number % BATCHES_OF_A_ROW == 0:
            share = sum(one == NUM_ROOMS for one in ended) / len(ended)
            whole = float(bonus.sum() / visits.sum())
            by_room = (bonus / visits / (whole or 1))[1:].tolist()
            figures = (share, sum(ended) / len(ended), *by_room)
            yield (number * batch.numel(), *(f"{one:.3f}" for one in figures))
            ended, bonus, visits = [], 0 * bonus, 0 * visits
        if progress[0] >= 1:
            break
    collector.shutdown()


def _follow(
    batch: TensorDictBase, room: Tensor, deepest: Tensor
) -> tuple[Tensor, list[int]]:
    """The deepest room of running episodes, and of those that ended."""
    ended = []
    done = batch["next", "done"].squeeze(-1)
    for now, over in zip(room.unbind(1), done.unbind(1), strict=True):
        deepest = deepest.maximum(now)
        ended += deepest[over].tolist()
        deepest = deepest.masked_fill(over, 1)
    return deepest, ended


def main() -> None:
    """Explore with every method and seed, and write the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--decisions", type=int, default=256_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    pay = tuple(f"pay_room_{room}" for room in range(1, NUM_ROOMS + 1))
    table = CurveTable(options.out, ("far_share", "deepest_room", *pay))
    for seed, method in product(options.seeds, options.methods):
        run = ("rooms", seed, method)
        if not table.has(*run):
            table.add(run, explore(method, seed, options.decisions))


if __name__ == "__main__":
    main()
