"""Thresholds of the temporal correlation, measured on sequences of random actions.

Neither function reads ground truth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from toponav.graph.waypoint_share import Comparing, WalkWaypoints, prepare_walks

#: Share of the observations that become waypoints of the map: the paper, Table 1, at
#: k = 4, the mean over 30 random sequences.
MAP_SHARE = 0.125
#: The same of the reward's memory: one waypoint for a place visited. A random walk of
#: 1800 decisions then leaves 27 waypoints, about as many as it visits cells (40 % of
#: 63). At the map's share most views beside a waypoint count as new, and each is
#: rewarded, so that jitter earns more than exploring. In our trials reward followed
#: coverage from 1.1 to 2.2 %, at thresholds between .5 and .7 of one network and up to
#: .9 of another: the share carries over, the number does not.
REWARD_SHARE = 0.015

#: Largest logit tried; one more and float32 rounds the probability to 1.
_WIDEST = 16.0
_MOST_TRIALS = 24


@dataclass(frozen=True)
class Calibration:
    """A threshold and how well it does what it was chosen for."""

    threshold: float  # similarity in [0, 1]; what lies above it counts as close
    target: float  # what was asked for
    achieved: float  # what the threshold gives
    per_sequence: tuple[float, ...] = ()  # ``achieved`` of each, by `calibrate_share`


def calibrate_share(
    sequences: Sequence[Tensor | WalkWaypoints],
    network: Comparing,
    *,
    target_share: float,
) -> Calibration:
    """Choose tc_th, the threshold at which random sequences keep a share of waypoints.

    Bisection over logits, to within 2 % of the target: near 1, where the answer lies,
    the share is steep in the probability. The share depends on the length, as longer
    walks come back more often: take complete episodes. A network that cannot give the
    share gets the closest threshold tried: compare ``achieved`` with ``target``.

    Args:
        sequences: embeddings ``[T, D]`` in the order of observation, or prepared walks.
        network: compares, see `Comparing`.
        target_share: waypoints per observation, in (0, 1), such as `MAP_SHARE`.
    """
    if not 0 < target_share < 1:
        raise ValueError(f"target_share must lie in (0, 1), got {target_share}.")
    walks = prepare_walks(sequences, network)

    def measure(logit: float) -> Calibration:
        threshold = 1 / (1 + math.exp(-logit))
        shares = tuple(walk.share(threshold) for walk in walks)
        return Calibration(threshold, target_share, sum(shares) / len(shares), shares)

    def error(found: Calibration) -> float:
        return abs(found.achieved - target_share)

    best = found = measure(0.0)
    logit, step = 0.0, 1.0
    # Once the answer is passed, every turn halves the step.
    passed = False
    previous = found.achieved < target_share
    for _ in range(_MOST_TRIALS):
        too_few = found.achieved < target_share
        passed = passed or too_few != previous
        step = step / 2 if passed else step
        logit += step if too_few else -step
        if error(best) <= 0.02 * target_share or abs(logit) > _WIDEST:
            break
        previous = too_few
        found = measure(logit)
        best = min(best, found, key=error)
    return best


def calibrate_reach(
    sequences: Sequence[Tensor | WalkWaypoints],
    network: Comparing,
    *,
    tc_threshold: float,
    max_action_distance: int = 4,
    pass_rate: float = 0.9,
) -> Calibration:
    """Choose tc_re, above which one place counts as reachable from another.

    ``pass_rate`` of all pairs of views at most k decisions apart pass. An edge means
    "an agent gets there in k decisions", so the network's similarity of such pairs is
    the evidence, and missing one in ten is cheap, as many pairs link two places. The
    paper asks for 0.5 < tc_re < tc_th; a value outside is moved 5 % of that interval
    inside its nearer end, and ``achieved`` then shows the cost. (If tc_th <= 0.5, the
    interval is empty and tc_re = tc_th.)

    Reference:
        The paper, eqs. 10 and 12; A12 of our readings.

    Args:
        sequences: as in `calibrate_share`.
        network: compares, see `Comparing`.
        tc_threshold: tc_th, from `calibrate_share`.
        max_action_distance: k.
        pass_rate: share of the pairs that pass, in (0, 1).
    """
    if not 0 < pass_rate < 1:
        raise ValueError(f"pass_rate must lie in (0, 1), got {pass_rate}.")
    near = torch.from_numpy(
        np.concatenate(
            [
                np.diagonal(walk.later, apart)
                for walk in prepare_walks(sequences, network)
                for apart in range(1, max_action_distance + 1)
            ]
        )
    )
    if not len(near):
        raise ValueError("a sequence must hold two observations, got one in each.")
    threshold = float(near.quantile(1 - pass_rate))
    floor = min(0.5, tc_threshold)
    margin = 0.05 * (tc_threshold - floor)
    threshold = min(max(threshold, floor + margin), tc_threshold - margin)
    return Calibration(threshold, pass_rate, float((near > threshold).double().mean()))
