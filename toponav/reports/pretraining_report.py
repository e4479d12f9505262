"""What a pre-training writes: curves, thresholds, a report against the ground truth."""

import copy
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor
from torchrl.record.loggers import Logger

from toponav import graph, metrics
from toponav.builders import Networks, World, one_thread
from toponav.config import PretrainConfig
from toponav.data import HeldOut, LPairs, PairSet, TCPairs
from toponav.ground_truth import (
    GroundTruthDistances,
    PairTruth,
    pair_truth,
    require_motion,
)
from toponav.plotting import draw_curves, draw_report, save_figure
from toponav.reports.place_errors import place_errors
from toponav.runs import Figures, write_history, write_text
from toponav.training import Validation

# Sequences of a maze that thresholds are calibrated on.
_MAX_SEQUENCES = 30
# Pairs of poses that train the bound.
_BOUND_PAIRS = 20_000
_REPORT_PAIRS = 6000
# Thresholds at which networks are compared: the calibrated one gives all of them the
# same share of waypoints.
_SHARES_AT = (0.5, 0.9)
# What the curves show of the TC-network.
_TC = ["tc_accuracy", "tc_accuracy_k4_m5", "tc_positives", "tc_negatives", "tc_auc"]


def write_measurements(
    folder: Path, loggers: Sequence[Logger], history: Sequence[Figures]
) -> None:
    """Log the last measurement, and write all as ``metrics.csv`` and ``curves.png``.

    Loggers get every figure under ``pretrain/<name>``, at the ``update`` that it has.
    """
    last = history[-1]
    named = {f"pretrain/{name}": value for name, value in last.items()}
    for logger in loggers:
        logger.log_metrics(named, step=int(last["update"]))
    write_history(folder / "metrics.csv", history)
    accuracies = {
        "TC-network, held out": _TC,
        "L-network, held out, by offset": sorted(
            name for name in last if name.startswith("l_accuracy_")
        ),
    }
    panels = accuracies | {"Losses": ["loss_tc", "loss_locomotion"]}
    figure = draw_curves(history, panels=panels, x="update", percent=list(accuracies))
    save_figure(figure, folder / "curves.png")


def progress_figures(figures: Figures) -> dict[str, str]:
    """Losses and accuracies for a progress bar."""
    return {
        "loss_tc": f"{figures['loss_tc']:.3f}",
        "loss_l": f"{figures['loss_locomotion']:.3f}",
        "tc": f"{figures['tc_accuracy']:.1%}",
        "l": f"{figures['l_accuracy']:.1%}",
    }


def write_reports(
    folder: Path,
    validation: Validation,
    worlds: Sequence[World],
    config: PretrainConfig,
) -> dict[str, dict[str, float]]:
    """Calibrate thresholds, measure the networks, write ``report.json`` and pictures.

    Thresholds come from random walks alone. Worlds with ground truth get a picture
    each: ``report.png``, or ``report_<world>.png`` if there are several worlds. The
    networks of ``validation`` get the thresholds. Returns the measurements by world.
    """
    networks = validation.networks
    walks = _compare_sequences(validation, _embed_sequences(validation))
    calibrations = _calibrate(networks, walks, config)
    # Ever closer to 1, where the waypoint share is steep, to just above tc_threshold.
    highest = math.log(1 / max(1 - networks.thresholds["tc_threshold"], 1e-6)) + 1
    thresholds = torch.linspace(-3, highest, 10).sigmoid()
    curve = thresholds, graph.share_curve(walks, thresholds.tolist())
    shares = graph.share_curve(walks, _SHARES_AT).mean(0).tolist()
    figures: dict[str, dict[str, float]] = {}
    bounds: dict[str, list[float]] = {}
    for number, held_out in enumerate(validation.held_out):
        world = worlds[number]
        if world.layout is None or not world.spec.has_truth:
            figures[held_out.name] = _measure_blindly(validation, number)
            continue
        seed = config.seed + number
        tc, locomotion, more = _measure(validation, world, held_out, config, seed=seed)
        figures[held_out.name] = {**tc.numbers(), **more, **locomotion.numbers()}
        bound = metrics.bayes_bound(config.pairs.locomotion_k, world=world.spec)
        bounds["l_bayes_bound"] = bound.tolist()
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
        name = "report" if len(worlds) == 1 else f"report_{held_out.name}"
        save_figure(figure, folder / f"{name}.png", dpi=150)
    content = {
        "mazes": figures,
        "waypoint_share": dict(zip(map(str, _SHARES_AT), shares, strict=True)),
        "thresholds": {name: asdict(one) for name, one in calibrations.items()},
        **bounds,
    }
    # Rounded for reading, and null where there is no number: JSON knows no NaN.
    plain = json.loads(
        json.dumps(content),
        parse_float=lambda text: round(float(text), 6),
        parse_constant=lambda _: None,
    )
    write_text(folder / "report.json", json.dumps(plain, indent=2) + "\n")
    return figures


def _embed_sequences(validation: Validation) -> list[tuple[Tensor, Tensor]]:
    """Embeddings of some walks, ``[T, D]`` each, and the episode of each view."""
    per_world = max(1, _MAX_SEQUENCES // len(validation.held_out))
    sequences: list[tuple[Tensor, Tensor]] = []
    for held_out in validation.held_out:
        num = min(per_world, held_out.num_walks) * held_out.length
        encoder = validation.networks.tc.encoder
        embeddings = validation.embed(encoder, held_out.pixels[:num])
        entries = embeddings, held_out.episode[:num]
        sequences += zip(*(one.split(held_out.length) for one in entries), strict=True)
    return sequences


def _compare_sequences(
    validation: Validation, sequences: list[tuple[Tensor, Tensor]]
) -> list[graph.WalkWaypoints]:
    def compare(sequence: tuple[Tensor, Tensor]) -> graph.WalkWaypoints:
        embeddings, episode = sequence
        # A thread enters a context of its own.
        with copy.copy(validation.autocast):
            return graph.WalkWaypoints(embeddings, validation.networks.tc, episode)

    # The products are small: a sequence a core is faster than all cores on each.
    with ThreadPoolExecutor(torch.get_num_threads()) as pool, one_thread():
        return list(pool.map(compare, sequences))


def _calibrate(
    networks: Networks, walks: list[graph.WalkWaypoints], config: PretrainConfig
) -> dict[str, graph.Calibration]:
    found = {"tc_threshold": graph.calibrate_share(walks, target_share=graph.MAP_SHARE)}
    found["tc_reach"] = graph.calibrate_reach(
        walks,
        tc_threshold=found["tc_threshold"].threshold,
        max_action_distance=config.pairs.k,
    )
    # Where an episode ends the map goes on, and the reward's memory does not.
    found["reward_threshold"] = graph.calibrate_share(
        walks, target_share=graph.REWARD_SHARE, episodic=True
    )
    networks.thresholds = {name: one.threshold for name, one in found.items()}
    return found


def _measure_blindly(validation: Validation, number: int) -> dict[str, float]:
    """What can be measured in a world without ground truth."""
    found = validation.measure(number)
    names = {"accuracy": "tc_accuracy", "auc": "tc_auc"}
    names |= {name[2:]: name for name in found if name.startswith("l_accuracy_")}
    return {name: found[measured] for name, measured in names.items()}


def _measure(
    validation: Validation,
    world: World,
    held_out: HeldOut,
    config: PretrainConfig,
    *,
    seed: int,
) -> tuple[metrics.TCReport, metrics.LReport, dict[str, float]]:
    rule, k = TCPairs(config.pairs.k, config.validate.m), config.pairs.locomotion_k
    motion = require_motion(world.spec)
    distances = GroundTruthDistances(world.floor, cell_size=motion.cell_size)

    def apart(pairs: PairSet) -> PairTruth:
        return pair_truth(distances, *held_out.poses(pairs), motion=motion)

    def features(pairs: PairSet) -> tuple[Tensor, Tensor]:
        return metrics.pose_features(*held_out.poses(pairs), apart(pairs)), pairs.label

    test = held_out.draw(rule, _REPORT_PAIRS, seed=seed)
    tc = metrics.tc_report(
        validation.similarity(held_out, test),
        test.label,
        apart(test),
        cell_size=motion.cell_size,
        max_action_distance=config.pairs.k,
    )
    l_pairs = held_out.draw(LPairs(k), _REPORT_PAIRS, seed=seed)
    locomotion = metrics.l_report(
        validation.logits(held_out, l_pairs),
        l_pairs.action,
        l_pairs.distance,
        metrics.useful_actions(*held_out.poses(l_pairs), world=world.spec),
        max_action_distance=k,
    )
    train = held_out.draw(rule, _BOUND_PAIRS, seed=seed + 1)
    bound = metrics.pose_bound(features(train), features(test))
    errors = place_errors(validation, distances, held_out, min_gap=rule.min_distance)
    return tc, locomotion, {"pose_bound": bound, **errors}


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
            revisit = f"another visit {found['place_error_revisit']:.1%}"
            parts.append(f"place error {found['place_error']:.1%} ({revisit})")
        shares = [share for key, share in found.items() if key.startswith("accuracy_")]
        by_offset = " / ".join(f"{share:.0%}" for share in shares)
        lines.append(f"{name}: {', '.join(parts)}; L by offset {by_offset}")
    at = [f"{name} {value:.3f}" for name, value in networks.thresholds.items()]
    return "\n".join([*lines, f"thresholds: {', '.join(at)}"])
