"""Episodes by which an exploration is judged, with blind baselines beside."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from toponav.builders import (
    World,
    collect_rollout,
    for_inference,
    make_walk_policy,
    seed_of,
)
from toponav.config import ExploreConfig
from toponav.keys import (
    CELL,
    COUNT_REWARD,
    COVERAGE,
    DECISIONS_TO_COVERAGE,
    HEADING,
    IS_NEW_WAYPOINT,
    POSITION,
    SPURIOUS_WAYPOINT,
    TEMPORAL_DISTANCE_REWARD,
)
from toponav.runs import write_history
from toponav.training import (
    BASELINES,
    COVERAGE_LEVELS,
    Explorer,
    Row,
    make_explore_env,
    mean_of,
)

# Environments side by side at most.
_MAX_ENVS = 32
# Apart from the seeds of training.
_EVALUATION = 77
#: What is kept of each decision where it is there, for tables and pictures.
_KEPT: list[NestedKey] = [
    POSITION,
    HEADING,
    CELL,
    COVERAGE,
    DECISIONS_TO_COVERAGE,
    IS_NEW_WAYPOINT,
    SPURIOUS_WAYPOINT,
]


@dataclass
class Evaluation:
    """Episodes of one policy.

    Args:
        policy: its name.
        episodes: ``[N, T]`` decisions with poses, coverage, waypoints and rewards.
        views: uint8 ``[T + 1, H, W, 3]``; what was seen in the first one.
        reward_key: of the reward that the explorer learned from.
    """

    policy: str
    episodes: TensorDictBase
    views: torch.Tensor
    reward_key: NestedKey

    def mean(self, column: str) -> float:
        """Mean of a column of `rows`."""
        return mean_of(self.rows(), column)

    def rows(self) -> list[Row]:
        """A row of ``evaluation.csv`` for each episode."""
        later = self.episodes.get("next")
        returns = later.get(self.reward_key).sum(1).flatten().tolist()
        return [
            {
                "policy": self.policy,
                "seed": number,
                **_coverage(later[number, -1]),
                "intrinsic_return": returns[number],
            }
            for number in range(len(later))
        ]


def _coverage(last: TensorDictBase) -> Row:
    """Coverage after an episode, and the decisions it took, where that is known."""
    coverage = last.get(COVERAGE, None)
    if coverage is None:
        return {}
    names = [f"decisions_to_{round(100 * level)}" for level in COVERAGE_LEVELS]
    decisions = last.get(DECISIONS_TO_COVERAGE).tolist()
    return {"coverage": float(coverage), **dict(zip(names, decisions, strict=True))}


def make_baselines(world: World, *, seed: int) -> dict[str, TensorDictModuleBase]:
    """Policies that see nothing: uniform, and one that mostly repeats its action."""
    kinds = {"random": "uniform", "sticky": "sticky"}
    return {
        name: make_walk_policy(kind, world.spec, seed=seed)
        for name, kind in kinds.items()
    }


def evaluate_policies(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    policies: Mapping[str, TensorDictModuleBase],
) -> list[Evaluation]:
    """Play whole episodes, with actions sampled as in training.

    All policies meet the same episodes. The blind baselines play
    ``evaluate.random_episodes``, the others ``evaluate.episodes``.

    Args:
        settings: of the run.
        world: where they play.
        explorer: its reward is computed along the way.
        policies: who plays, by name.

    Raises:
        EngineError: if the engine cannot start.
    """
    evaluate, length = settings.evaluate, world.episode_length
    wanted = {
        name: evaluate.random_episodes if name in BASELINES else evaluate.episodes
        for name in policies
    }
    rows = min(max(wanted.values()), _MAX_ENVS)
    explorer = copy.deepcopy(explorer)
    if explorer.novelty is not None:
        for_inference(explorer.novelty, settings.model)
    env = make_explore_env(settings, world, explorer, envs=rows, seed=0)
    rounds = {name: -(-number // rows) for name, number in wanted.items()}
    total = sum(rounds.values()) * rows * length
    reward = explorer.reward.reward_key
    keep_next = [*_KEPT, reward, COUNT_REWARD, TEMPORAL_DISTANCE_REWARD]
    found = []
    with tqdm(total=total, unit="decision", desc="evaluate") as bar:
        try:
            for name, policy in policies.items():
                bar.set_description(f"evaluate {name}")
                # The same episodes for each: they follow from seed and row.
                env.set_seed(seed_of(settings.seed, _EVALUATION))
                torch.manual_seed(seed_of(settings.seed, _EVALUATION, 1))
                played = [
                    collect_rollout(
                        env,
                        policy,
                        length,
                        keep=_KEPT,
                        keep_next=keep_next,
                        views=length + 1,
                        progress=bar.update,
                    )
                    for _ in range(rounds[name])
                ]
                episodes = torch.cat([one.frames for one in played])[: wanted[name]]
                found.append(Evaluation(name, episodes, played[0].views, reward))
        finally:
            env.close()
    return found


def write_evaluation(
    folder: Path, evaluations: list[Evaluation], earlier: Sequence[Row] = ()
) -> list[Row]:
    """Write ``evaluation.csv``, the new episodes before earlier ones; returns all."""
    rows = [row for one in evaluations for row in one.rows()]
    rows += [row for row in earlier if row not in rows]
    write_history(folder / "evaluation.csv", rows)
    return rows


def summarize_evaluation(world: str, rows: list[Row]) -> str:
    """How the explorer compares with blind baselines, in a few lines.

    Examples:
        >>> def row(policy, coverage, decisions):
        ...     found = {"policy": policy, "coverage": coverage}
        ...     return found | {"decisions_to_90": decisions}
        >>> rows = [row("best", 0.75, -1), row("best", 1.0, 400)]
        >>> rows.append(row("random", 0.4, -1))
        >>> print(summarize_evaluation("maze3", rows))
        maze3: best policy covers 87.5 % of the maze (1 of 2 episodes reach 90 %, after
        400 decisions on average); random covers 40.0 % (0 of 1): 2.2 times as much
    """
    names = list(dict.fromkeys(str(row["policy"]) for row in rows))
    by_name = {name: [row for row in rows if row["policy"] == name] for name in names}
    if "coverage" not in rows[0]:
        returns = "; ".join(
            f"{name} {mean_of(some, 'intrinsic_return'):.1f}"
            for name, some in by_name.items()
        )
        return f"{world}: intrinsic return per episode: {returns}"
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
        f"{world}: {first} policy covers {cover[first] * 100:.1f} % of the maze "
        f"({len(soon)} of {len(by_name[first])} episodes reach 90 %"
        f"{after if soon else ''}); {others}"
    )
