"""Episodes by which an exploration is judged, with walks that see nothing beside."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from toponav.builders.episode_log import Row, mean_of
from toponav.builders.explore_collector import seed_of
from toponav.builders.explore_env import COVERAGE_LEVELS, make_explore_env
from toponav.builders.novelty import Novelty, for_use
from toponav.builders.run_files import write_history
from toponav.config import ExploreConfig
from toponav.evaluation import RandomPolicy, StickyPolicy
from toponav.keys import (
    BORN,
    CELL,
    COUNT_REWARD,
    COVERAGE,
    DECISIONS_TO_COVERAGE,
    FALSE_BIRTH,
    HEADING,
    INTRINSIC_REWARD,
    PIXELS,
    POSITION,
    TEMPORAL_DISTANCE_REWARD,
)

# Mazes side by side at most.
_MAX_ENVS = 32
# Apart from the seeds of training.
_EVALUATION = 77
_KEPT: list[NestedKey] = [
    POSITION,
    HEADING,
    CELL,
    COVERAGE,
    DECISIONS_TO_COVERAGE,
    BORN,
    FALSE_BIRTH,
]
_PAID: list[NestedKey] = [INTRINSIC_REWARD, COUNT_REWARD, TEMPORAL_DISTANCE_REWARD]


@dataclass
class Evaluation:
    """Episodes of one policy.

    Args:
        policy: its name.
        episodes: ``[N, T]`` decisions with poses, coverage, births and rewards.
        views: uint8 ``[T + 1, H, W, 3]``; what was seen in the first one.
    """

    policy: str
    episodes: TensorDictBase
    views: torch.Tensor

    def mean(self, column: str) -> float:
        """Mean of a column of `rows`."""
        return mean_of(self.rows(), column)

    def rows(self) -> list[Row]:
        """A row of ``evaluation.csv`` for each episode."""
        later = self.episodes.get("next")
        last = later[:, -1]
        returns = later.get(INTRINSIC_REWARD).sum(1).flatten().tolist()
        levels = [f"decisions_to_{round(100 * level)}" for level in COVERAGE_LEVELS]
        return [
            {
                "policy": self.policy,
                "seed": number,
                "coverage": float(last[number].get(COVERAGE)),
                **dict(
                    zip(
                        levels,
                        last[number].get(DECISIONS_TO_COVERAGE).tolist(),
                        strict=True,
                    )
                ),
                "intrinsic_return": returns[number],
            }
            for number in range(len(last))
        ]


def evaluate_policies(
    config: ExploreConfig,
    novelty: Novelty,
    policies: dict[str, TensorDictModuleBase],
) -> list[Evaluation]:
    """Play whole episodes, with actions sampled as in training.

    All policies meet the same episodes: maze, starts and headings. The walks
    ``random`` and ``sticky`` play ``evaluate.random_episodes``, the others
    ``evaluate.episodes``.

    Args:
        config: settings of the run.
        novelty: the TC-network and the reward's threshold.
        policies: who plays, by name.

    Raises:
        EngineError: if the engine cannot start.
    """
    evaluate, length = config.evaluate, config.maze.episode_length
    wanted = {
        name: evaluate.random_episodes if is_walk(policy) else evaluate.episodes
        for name, policy in policies.items()
    }
    rows = min(max(wanted.values()), _MAX_ENVS)
    novelty = for_use(copy.deepcopy(novelty), config.model)
    env = make_explore_env(config, novelty, envs=rows, seed=0)
    rounds = {name: -(-number // rows) for name, number in wanted.items()}
    bar = tqdm(
        total=sum(rounds.values()) * rows * length, unit="decision", desc="evaluate"
    )
    found = []
    try:
        for name, policy in policies.items():
            bar.set_description(f"evaluate {name}")
            # The same episodes for each: scenes follow from seed and row.
            env.set_seed(seed_of(config.seed, _EVALUATION))
            torch.manual_seed(seed_of(config.seed, _EVALUATION, 1))
            played = [play(env, policy, length, bar) for _ in range(rounds[name])]
            episodes = torch.cat([one for one, _ in played])[: wanted[name]]
            found.append(Evaluation(name, episodes, played[0][1]))
    finally:
        bar.close()
        env.close()
    return found


@torch.no_grad()
def play(
    env: EnvBase, policy: TensorDictModuleBase, decisions: int, bar: tqdm
) -> tuple[TensorDictBase, torch.Tensor]:
    """One episode of each row, ``[E, T]``, and the views of the first row."""
    now, steps, views = env.reset(), [], []
    with set_exploration_type(ExplorationType.RANDOM):
        for _ in range(decisions):
            step, following = env.step_and_maybe_reset(policy(now))
            kept = step.select(*_KEPT)
            kept["next"] = step["next"].select(*_KEPT, *_PAID)
            steps.append(kept)
            views.append(step[PIXELS][0].clone())
            now = following
            bar.update(len(step))
        views.append(step["next", PIXELS][0].clone())
    return torch.stack(steps, 1), torch.stack(views)


def is_walk(policy: TensorDictModuleBase) -> bool:
    """Whether a policy sees nothing."""
    return isinstance(policy, RandomPolicy | StickyPolicy)


def write_evaluation(
    folder: Path, evaluations: list[Evaluation], earlier: Sequence[Row] = ()
) -> list[Row]:
    """Write ``evaluation.csv``, the new episodes before earlier ones; returns all."""
    rows = [row for one in evaluations for row in one.rows()]
    rows += [row for row in earlier if row not in rows]
    write_history(folder / "evaluation.csv", rows)
    return rows


def summarize_evaluation(maze: str, rows: list[Row]) -> str:
    """How the explorer compares with walks that see nothing, in a few lines.

    Examples:
        >>> def row(policy, coverage, decisions):
        ...     told = {"policy": policy, "coverage": coverage}
        ...     return told | {"decisions_to_90": decisions}
        >>> rows = [row("best", 0.75, -1), row("best", 1.0, 400)]
        >>> rows.append(row("random", 0.4, -1))
        >>> print(summarize_evaluation("maze3", rows))
        maze3: best policy covers 87.5 % of the maze (1 of 2 episodes reach 90 %, after
        400 decisions on average); random covers 40.0 % (0 of 1): 2.2 times as much
    """
    names = list(dict.fromkeys(str(row["policy"]) for row in rows))
    by_name = {name: [row for row in rows if row["policy"] == name] for name in names}
    cover = {name: mean_of(some, "coverage") for name, some in by_name.items()}

    def reached(name: str) -> list[Row]:
        return [row for row in by_name[name] if row["decisions_to_90"] >= 0]

    first = names[0]
    soon = reached(first)
    after = f", after {mean_of(soon, 'decisions_to_90'):,.0f} decisions on average"
    others = "; ".join(
        f"{name} covers {cover[name]:.1%} ({len(reached(name))} of "
        f"{len(by_name[name])})"
        + (
            f": {cover[first] / cover[name]:.1f} times as much"
            if name == "random" and cover[name]
            else ""
        )
        for name in names[1:]
    ).replace("%", " %")
    return (
        f"{maze}: {first} policy covers {cover[first] * 100:.1f} % of the maze "
        f"({len(soon)} of {len(by_name[first])} episodes reach 90 %"
        f"{after if soon else ''}); {others}"
    )
