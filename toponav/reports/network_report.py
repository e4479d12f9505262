"""Thresholds of trained networks, and the report against the ground truth."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from toponav.builders import Networks, one_thread
from toponav.config import PretrainConfig
from toponav.data import HeldOut, LPairs, PairSet, TCPairs
from toponav.envs import Layout
from toponav.graph import (
    MAP_SHARE,
    REWARD_SHARE,
    Calibration,
    WalkWaypoints,
    calibrate_reach,
    calibrate_share,
    share_curve,
)
from toponav.ground_truth import GroundTruthDistances, PairTruth, pair_truth
from toponav.metrics import (
    LReport,
    TCReport,
    bayes_bound,
    l_report,
    pose_bound,
    pose_features,
    tc_report,
    useful_actions,
)
from toponav.plotting import ShareCurve, draw_report, save_figure
from toponav.reports.place_errors import place_errors
from toponav.runs import write_text
from toponav.training import Validation
from toponav.worlds import Motion, WorldSpec

# Sequences of a maze that thresholds are calibrated on.
_MAX_SEQUENCES = 30
# Pairs of poses that train the bound.
_BOUND_PAIRS = 20_000
_REPORT_PAIRS = 6000
# Thresholds at which networks are compared: the calibrated one gives all of them the
# same share of waypoints.
_SHARES_AT = (0.5, 0.9)


class Truth(NamedTuple):
    """The ground truth of a world with poses."""

    distances: GroundTruthDistances
    world: WorldSpec
    motion: Motion

    def of(self, held_out: HeldOut, pairs: PairSet) -> PairTruth:
        """How far apart the views of pairs are."""
        return pair_truth(self.distances, *held_out.poses(pairs), motion=self.motion)


def make_truth(layout: Layout | None, world: WorldSpec) -> Truth | None:
    """The ground truth of a world, ``None`` where it has none."""
    if layout is None or world.motion is None:
        return None
    distances = GroundTruthDistances(
        torch.from_numpy(layout.open_mask), cell_size=world.motion.cell_size
    )
    return Truth(distances, world, world.motion)


def write_reports(
    folder: Path,
    validation: Validation,
    truths: Sequence[Truth | None],
    config: PretrainConfig,
) -> dict[str, dict[str, float]]:
    """Calibrate thresholds, measure the networks, write ``report.json`` and pictures.

    Thresholds come from random walks alone. Worlds with ground truth get a picture
    each: ``report.png``, or ``report_<world>.png`` if there are several worlds.

    Args:
        folder: the run folder.
        validation: holds the networks, which get the thresholds, and the episodes.
        truths: the ground truth of each world.
        config: settings of the run.

    Returns:
        The measurements by world.
    """
    networks = validation.networks
    sequences = _embed_sequences(validation)
    with validation.autocast, one_thread():
        walks = [WalkWaypoints(one, networks.tc) for one in sequences]
        calibrations = _calibrate(networks, walks, config)
    # Ever closer to 1, where the waypoint share is steep, to just above tc_threshold.
    highest = math.log(1 / max(1 - networks.thresholds["tc_threshold"], 1e-6)) + 1
    thresholds = torch.linspace(-3, highest, 10).sigmoid()
    curve = ShareCurve(thresholds, share_curve(walks, thresholds.tolist()))
    shares = share_curve(walks, _SHARES_AT).mean(0).tolist()
    content: dict[str, object] = {}
    figures: dict[str, dict[str, float]] = {}
    for number, held_out in enumerate(validation.held_out):
        truth = truths[number]
        if truth is None:
            figures[held_out.name] = _measure_blindly(validation, number)
            continue
        bound = bayes_bound(config.pairs.locomotion_k, world=truth.world)
        content["l_bayes_bound"] = bound.tolist()
        tc, locomotion, more = _measure(
            validation, truth, held_out, config, seed=config.seed + number
        )
        figures[held_out.name] = {**tc.numbers(), **more, **locomotion.numbers()}
        name = "report.png" if len(truths) == 1 else f"report_{held_out.name}.png"
        figure = draw_report(
            tc,
            locomotion,
            curve,
            marks=calibrations,
            bound=bound,
            pose_bound=more["pose_bound"],
            num_actions=networks.num_actions,
            title=f"{held_out.name}: {config.collect.decisions:,} decisions, "
            f"{config.train.updates:,} updates, seed {config.seed}",
        )
        save_figure(figure, folder / name, dpi=150)
    content = {
        "mazes": figures,
        "waypoint_share": dict(zip(map(str, _SHARES_AT), shares, strict=True)),
        "thresholds": {name: asdict(one) for name, one in calibrations.items()},
        **content,
    }
    write_text(folder / "report.json", json.dumps(_plain(content), indent=2) + "\n")
    return figures


def _embed_sequences(validation: Validation) -> list[Tensor]:
    per_world = max(1, _MAX_SEQUENCES // len(validation.held_out))
    sequences: list[Tensor] = []
    for held_out in validation.held_out:
        num = min(per_world, held_out.num_episodes) * held_out.length
        embeddings = validation.embed(
            validation.networks.tc.encoder, held_out.pixels[:num]
        )
        sequences += embeddings.split(held_out.length)
    return sequences


def _calibrate(
    networks: Networks, walks: list[WalkWaypoints], config: PretrainConfig
) -> dict[str, Calibration]:
    found = {"tc_threshold": calibrate_share(walks, target_share=MAP_SHARE)}
    found["tc_reach"] = calibrate_reach(
        walks,
        tc_threshold=found["tc_threshold"].threshold,
        max_action_distance=config.pairs.k,
    )
    found["reward_threshold"] = calibrate_share(walks, target_share=REWARD_SHARE)
    networks.thresholds = {name: one.threshold for name, one in found.items()}
    return found


def _measure_blindly(validation: Validation, number: int) -> dict[str, float]:
    """What can be measured in a world without ground truth."""
    found = validation.measure(number)
    by_offset = {
        name.removeprefix("l_"): value
        for name, value in found.items()
        if name.startswith("l_accuracy_")
    }
    return {"accuracy": found["tc_accuracy"], "auc": found["tc_auc"], **by_offset}


def _measure(
    validation: Validation,
    truth: Truth,
    held_out: HeldOut,
    config: PretrainConfig,
    *,
    seed: int,
) -> tuple[TCReport, LReport, dict[str, float]]:
    rule, k = TCPairs(config.pairs.k, config.validate.m), config.pairs.locomotion_k
    test = held_out.draw(rule, _REPORT_PAIRS, seed=seed)
    tc = tc_report(
        validation.similarity(held_out, test),
        test.label,
        truth.of(held_out, test),
        cell_size=truth.motion.cell_size,
        max_action_distance=config.pairs.k,
    )
    l_pairs = held_out.draw(LPairs(k), _REPORT_PAIRS, seed=seed)
    locomotion = l_report(
        validation.logits(held_out, l_pairs),
        l_pairs.action,
        l_pairs.distance,
        useful_actions(*held_out.poses(l_pairs), world=truth.world),
        max_action_distance=k,
    )
    train = held_out.draw(rule, _BOUND_PAIRS, seed=seed + 1)
    bound = pose_bound(
        (_pose_features(truth, held_out, train), train.label),
        (_pose_features(truth, held_out, test), test.label),
    )
    errors = place_errors(
        validation, truth.distances, held_out, min_gap=rule.min_distance
    )
    return tc, locomotion, {"pose_bound": bound, **errors}


def _pose_features(truth: Truth, held_out: HeldOut, pairs: PairSet) -> Tensor:
    return pose_features(*held_out.poses(pairs), truth.of(held_out, pairs))


def summarize(figures: Mapping[str, Mapping[str, float]], networks: Networks) -> str:
    """The measurements of `write_reports` in short, a line a world, and thresholds.

    Examples:
        >>> from types import SimpleNamespace
        >>> networks = SimpleNamespace(thresholds={"tc_threshold": 0.5})
        >>> measured = {"accuracy": 0.75, "auc": 0.8, "accuracy_1": 0.5}
        >>> print(summarize({"chain": measured}, networks))
        chain: TC 75.0%, AUC 0.800; L by offset 50%
        thresholds: tc_threshold 0.500
    """
    lines = []
    for name, found in figures.items():
        parts = [f"TC {found['accuracy']:.1%}", f"AUC {found['auc']:.3f}"]
        if "pose_bound" in found:
            parts[0] += f" (from true poses {found['pose_bound']:.1%})"
            parts.append(
                f"place error {found['place_error']:.1%} (another visit "
                f"{found['place_error_revisit']:.1%})"
            )
        shares = [share for key, share in found.items() if key.startswith("accuracy_")]
        by_offset = " / ".join(f"{share:.0%}" for share in shares)
        lines.append(f"{name}: {', '.join(parts)}; L by offset {by_offset}")
    at = [f"{name} {value:.3f}" for name, value in networks.thresholds.items()]
    return "\n".join([*lines, f"thresholds: {', '.join(at)}"])


def _plain(value: object) -> object:
    """Rounded for reading, and null where there is no number: JSON knows no NaN."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value
