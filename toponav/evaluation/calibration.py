"""Thresholds of the temporal correlation, measured on sequences of random actions.

- `calibrate_tc_threshold`: tc_th, above which two views are one place.
- `calibrate_reach`: tc_re, above which one place can be reached from another.
- `calibrate_reward_threshold`: what the reward's memory needs.

None of them sees the truth. All take embeddings of whole sequences, one ``[T, D]``
each, in the order of observation. See `waypoint_share.py` for the elimination.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.evaluation.waypoint_share import (
    Comparing,
    Waypoints,
    check_sequence,
    prepare_walks,
    recent_similarity,
)

#: Largest logit tried; one more and float32 rounds the probability to 1.
_WIDEST = 16.0
_MOST_TRIALS = 24


@dataclass(frozen=True)
class Calibration:
    """A threshold and how well it does what it was chosen for.

    Args:
        threshold: similarity in [0, 1]; what lies above it counts as close.
        target: the value the rule asks for.
        achieved: the value that the threshold gives.
        per_sequence: ``achieved`` of every sequence, if the rule has one.
    """

    threshold: float
    target: float
    achieved: float
    per_sequence: tuple[float, ...] = ()


@torch.no_grad()
def calibrate_tc_threshold(
    sequences: Sequence[Tensor | Waypoints],
    network: Comparing,
    *,
    target_share: float = 0.125,
) -> Calibration:
    """Choose tc_th so that random sequences keep the paper's share of waypoints.

    Bisection over logits: near 1, where the answer lies, the share is steep in the
    probability. The share depends weakly on the length, as longer walks come back
    more often; Table 1 takes one episode each. A network that cannot give the share
    (one that says the same to all pairs) gets the closest threshold met: compare
    ``achieved`` with ``target``.

    Reference:
        The paper, Table 1: 12.5 % at k = 4, mean over 30 random sequences.

    Args:
        sequences: ``[T, D]`` each, or prepared walks.
        network: compares, see `Comparing`.
        target_share: waypoints per observation, in (0, 1).

    Returns:
        The threshold, with the mean share and that of every sequence.

    Raises:
        ValueError: if ``target_share`` is out of range, there is no sequence, or as
            `waypoint_mask`.

    Examples:
        >>> class Nearness:
        ...     def prepare_memory(self, memory):
        ...         return memory
        ...     def compare_prepared(self, embedding, prepared):
        ...         return 1 / (1 + (embedding.unsqueeze(-2) - prepared).abs().sum(-1))
        >>> line = torch.arange(80.0).unsqueeze(1)
        >>> found = calibrate_tc_threshold([line], Nearness(), target_share=0.25)
        >>> found.achieved, 1 / 5 < found.threshold < 1 / 4  # 4 apart is a new place
        (0.25, True)
    """
    return _calibrate_share(sequences, network, target_share)


@torch.no_grad()
def calibrate_reward_threshold(
    sequences: Sequence[Tensor | Waypoints],
    network: Comparing,
    *,
    target_share: float = 0.015,
) -> Calibration:
    """Choose the threshold of the reward's memory: one waypoint for a place visited.

    tc_th is the wrong place for a reward: there most views beside a waypoint count as
    new, and each pays, so that jitter earns more than exploring. Rule: a share of
    1.5 %. A random walk of 1800 decisions then leaves 27 waypoints, about as many as
    it visits cells (40 % of 63). In our trials reward followed coverage from 1.1 to
    2.2 %, at thresholds between .5 and .7 of one network and up to .9 of another: the
    share carries over, the number does not.

    (Equal error of near and far pairs, the other rule that needs no truth, drifts
    upwards with better networks: some 5 % of the far pairs are truly near, so that
    many near ones would have to fail.)

    Args:
        sequences: ``[T, D]`` each, whole episodes of about 1800 decisions; shorter
            ones visit more cells per decision.
        network: compares, see `Comparing`.
        target_share: waypoints per observation, in (0, 1).

    Returns:
        The threshold, with the mean share and that of every sequence.

    Raises:
        ValueError: as `calibrate_tc_threshold`.
    """
    return _calibrate_share(sequences, network, target_share)


def _calibrate_share(
    sequences: Sequence[Tensor | Waypoints], network: Comparing, target: float
) -> Calibration:
    """The threshold whose mean share is within 2 % of the target, or the closest."""
    if not 0 < target < 1:
        raise ValueError(f"target_share must lie in (0, 1), got {target}.")
    if not sequences:
        raise ValueError("sequences must hold at least one, got none.")
    walks = prepare_walks(sequences, network)

    def measure(logit: float) -> Calibration:
        threshold = 1 / (1 + math.exp(-logit))
        shares = tuple(walk.share(threshold) for walk in walks)
        return Calibration(threshold, target, sum(shares) / len(shares), shares)

    best = found = measure(0.0)
    logit, step = 0.0, 1.0
    # Once the answer is passed, every turn halves the step.
    passed = False
    previous = found.achieved < target
    for _ in range(_MOST_TRIALS):
        too_few = found.achieved < target
        passed = passed or too_few != previous
        step = step / 2 if passed else step
        logit += step if too_few else -step
        if abs(best.achieved - target) <= 0.02 * target or abs(logit) > _WIDEST:
            break
        previous = too_few
        found = measure(logit)
        if abs(found.achieved - target) < abs(best.achieved - target):
            best = found
    return best


@torch.no_grad()
def calibrate_reach(
    sequences: Sequence[Tensor],
    network: Comparing,
    *,
    tc_threshold: float,
    max_action_distance: int = 4,
    pass_rate: float = 0.9,
) -> Calibration:
    """Choose tc_re, above which one place counts as reachable from another.

    Rule: ``pass_rate`` of all pairs of views at most k decisions apart pass. An edge
    means "a walker gets there in k decisions", so what the network says of such pairs
    is the evidence, and missing one in ten is cheap, as many pairs link two places.
    The paper asks for 0.5 < tc_re < tc_th; a value outside is moved 5 % of that
    interval inside its nearer end, and ``achieved`` then shows the cost. (If
    tc_th <= 0.5, the interval is empty and tc_re = tc_th.)

    Reference:
        The paper, eqs. 10 and 12; A12 of our readings.

    Args:
        sequences: ``[T, D]`` each.
        network: compares, see `Comparing`.
        tc_threshold: tc_th, from `calibrate_tc_threshold`.
        max_action_distance: k.
        pass_rate: share of the pairs that pass, in (0, 1).

    Returns:
        The threshold, with the share of pairs that pass.

    Raises:
        ValueError: if ``pass_rate`` is out of range, or no sequence holds a pair.
    """
    if not 0 < pass_rate < 1:
        raise ValueError(f"pass_rate must lie in (0, 1), got {pass_rate}.")
    near = near_similarity(sequences, network, max_action_distance)
    threshold = float(near.quantile(1 - pass_rate))
    floor = min(0.5, tc_threshold)
    margin = 0.05 * (tc_threshold - floor)
    threshold = min(max(threshold, floor + margin), tc_threshold - margin)
    return Calibration(threshold, pass_rate, float((near > threshold).double().mean()))


def near_similarity(
    sequences: Sequence[Tensor], network: Comparing, max_action_distance: int
) -> Tensor:
    """Similarities of all pairs at 1..k decisions, later view first, ``[N]``."""
    _check_any(sequences)
    found = [
        recent_similarity(sequence, network, max_action_distance).flatten()
        for sequence in sequences
    ]
    near = torch.cat(found).cpu()
    near = near[~near.isnan()]
    if not len(near):
        raise ValueError("a sequence must hold two observations, got one in each.")
    return near


def _check_any(sequences: Sequence[Tensor]) -> None:
    if not sequences:
        raise ValueError("sequences must hold at least one, got none.")
    for sequence in sequences:
        check_sequence(sequence)
