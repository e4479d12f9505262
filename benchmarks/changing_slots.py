"""Slots that close and open in mid-episode: does the agent go on reaching goals?

    python benchmarks/changing_slots.py --run runs/explore/maze1-... --out slots.json

Navigator, oracle and random agent play the same episodes of maze1. After each fifth of
an episode a slot changes: ``a`` closes, ``a`` opens, ``b`` closes, ``b`` opens. Goals
per 1000 decisions in each fifth tell whether the agent recovers: with a corridor
closed, paths are longer and have to be found, so that the oracle's figure falls too.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from tqdm import trange

from toponav.builders import (
    collect_rollout,
    load_exploration,
    make_goal_places,
    make_navigation_env,
)
from toponav.config import NavigateConfig
from toponav.keys import REWARD
from toponav.methods import register
from toponav.methods.navigators import make_policies
from toponav.metrics import bootstrap

CONF = Path(__file__).resolve().parent.parent / "conf"
#: What happens at the beginning of each fifth of an episode.
CHANGES = (None, ("a", True), ("a", False), ("b", True), ("b", False))
NAMES = ("all open", "a closed", "a open again", "b closed", "b open again")


def make_settings(run: str, length: int) -> NavigateConfig:
    """Those of the recipe, for episodes of so many decisions."""
    register()
    words = ["maze=maze1", f"run={run}", f"maze.episode_length={length}"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        settings = OmegaConf.to_object(compose("navigate", overrides=words))
    assert isinstance(settings, NavigateConfig)
    return settings


@torch.no_grad()
def play(
    env: EnvBase, policy: TensorDictModuleBase, length: int, *, name: str
) -> torch.Tensor:
    """Goals reached in each fifth of each episode, ``[E, 5]``."""
    part, envs = length // len(CHANGES), env.batch_size[0]
    with trange(envs * part * len(CHANGES), desc=name, unit="decision") as bar:

        def change_slots(decisions: int) -> None:
            bar.update(decisions)
            fifth, into = divmod(bar.n // envs, part)
            if into == 0 and fifth < len(CHANGES) and CHANGES[fifth] is not None:
                letter, closed = CHANGES[fifth]
                env.base_env.set_slot(letter, closed=closed)

        played = collect_rollout(
            env,
            policy,
            part * len(CHANGES),
            keep=(),
            keep_next=[REWARD],
            progress=change_slots,
        )
    is_goal = played.frames["next", REWARD].squeeze(-1) >= env.world.goal_reward
    return is_goal.float().unflatten(1, (len(CHANGES), part)).sum(-1)


def main() -> None:
    """Play, and say how many goals were reached when."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", required=True)
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--decisions", type=int, default=5000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    # One decision more than is played: no episode ends in between.
    settings = make_settings(arguments.run, arguments.decisions + 1)
    knowledge, truth = load_exploration(settings)
    places = make_goal_places(settings, knowledge, truth)
    policies = make_policies(settings, knowledge, truth)
    part = arguments.decisions // len(CHANGES)
    entries: dict[str, Any] = {
        "run": Path(arguments.run).name,
        "episodes": arguments.episodes,
        "decisions": arguments.decisions,
    }
    env = make_navigation_env(
        settings, places, envs=arguments.episodes, seed=settings.seed
    )
    try:
        for name, policy in policies.items():
            env.set_seed(settings.seed)
            rate = 1000 / part * play(env, policy, arguments.decisions, name=name)
            entries[name] = {}
            for period, column in zip(NAMES, rate.T, strict=True):
                found = bootstrap(column.tolist())
                entries[name][period] = [found.value, found.low, found.high]
    finally:
        env.close()
    entries["load"] = os.getloadavg()[0]
    words = json.dumps(entries, indent=2)
    print(words)
    if arguments.out:
        arguments.out.write_text(words + "\n")


if __name__ == "__main__":
    main()
