"""Thresholds of trained networks, and the report against the truth."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor

from toponav.builders.devices import one_thread
from toponav.builders.mazes import make_layout
from toponav.builders.networks import Networks
from toponav.builders.place_errors import place_errors
from toponav.builders.run_files import write_text
from toponav.builders.validation import Validation, embed_views
from toponav.config import MazeConfig, PretrainConfig
from toponav.data import HeldOut, LPairs, PairSet, TCPairs
from toponav.evaluation import (
    Calibration,
    LReport,
    MazeMetric,
    ShareCurve,
    TCReport,
    Waypoints,
    bayes_bound,
    calibrate_reach,
    calibrate_reward_threshold,
    calibrate_tc_threshold,
    draw_report,
    l_report,
    pair_truth,
    pose_bound,
    pose_features,
    prepare_walks,
    share_curve,
    tc_report,
    useful_actions,
)

# Sequences of a maze that thresholds are calibrated on.
_MAX_SEQUENCES = 30
# Pairs of poses that train the bound.
_BOUND_PAIRS = 20_000
_REPORT_PAIRS = 6000
# Thresholds at which networks are compared: the calibrated one gives all of them the
# same share of waypoints.
_SHARES_AT = (0.5, 0.9)


def embed_sequences(
    networks: Networks, validation: Validation, *, most: int = _MAX_SEQUENCES
) -> list[Tensor]:
    """Embeddings of held-out episodes, ``[T, D]`` each, the mazes in turn."""
    per_maze = max(1, most // len(validation.held_out))
    sequences: list[Tensor] = []
    for maze in validation.held_out:
        num = min(per_maze, maze.num_episodes)
        embeddings = embed_views(
            networks.tc.encoder,
            maze.pixels[: num * maze.length],
            device=validation.device,
            autocast=validation.autocast,
        )
        sequences += embeddings.split(maze.length)
    return sequences


def calibrate(
    networks: Networks,
    sequences: list[Tensor],
    walks: list[Waypoints],
    config: PretrainConfig,
) -> dict[str, Calibration]:
    """Choose the thresholds on random walks; they are saved with the networks.

    Args:
        networks: in ``eval()`` mode; get the thresholds.
        sequences: embeddings of episodes, see `embed_sequences`.
        walks: the same, compared with themselves.
        config: settings of the run.

    Returns:
        Each threshold and how well it does what it was chosen for, by name:
        ``tc_threshold``, ``tc_reach``, ``reward_threshold``.
    """
    found = {"tc_threshold": calibrate_tc_threshold(walks, networks.tc)}
    found["tc_reach"] = calibrate_reach(
        sequences,
        networks.tc,
        tc_threshold=found["tc_threshold"].threshold,
        max_action_distance=config.pairs.k,
    )
    found["reward_threshold"] = calibrate_reward_threshold(walks, networks.tc)
    networks.thresholds = {name: one.threshold for name, one in found.items()}
    return found


def write_reports(
    folder: Path,
    networks: Networks,
    validation: Validation,
    mazes: list[MazeConfig],
    config: PretrainConfig,
) -> dict[str, dict[str, float]]:
    """Calibrate, measure against the truth, write ``report.json`` and ``report.png``.

    With several mazes there is one picture each, ``report_<maze>.png``.

    Args:
        folder: the run folder.
        networks: in ``eval()`` mode; get the thresholds.
        validation: holds the held-out episodes.
        mazes: the settings of the mazes, in the same order.
        config: settings of the run.

    Returns:
        The figures by maze.
    """
    sequences = embed_sequences(networks, validation)
    with validation.autocast, one_thread():
        walks = prepare_walks(sequences, networks.tc)
        marks = calibrate(networks, sequences, walks, config)
    # Ever closer to 1, where the waypoint share is steep, to just above tc_threshold.
    highest = math.log(1 / max(1 - marks["tc_threshold"].threshold, 1e-6)) + 1
    thresholds = torch.linspace(-3, highest, 10).sigmoid()
    curve = ShareCurve(
        thresholds,
        share_curve(walks, networks.tc, thresholds.tolist()),
    )
    shares = share_curve(walks, networks.tc, _SHARES_AT).mean(0).tolist()
    figures: dict[str, dict[str, float]] = {}
    for number, (maze, held_out) in enumerate(
        zip(mazes, validation.held_out, strict=True)
    ):
        tc, locomotion, more = _measure(
            networks, validation, maze, held_out, config, seed=config.seed + number
        )
        figures[held_out.name] = {**tc.numbers(), **more, **locomotion.numbers()}
        name = "report.png" if len(mazes) == 1 else f"report_{held_out.name}.png"
        draw_report(
            tc,
            locomotion,
            curve,
            marks=marks,
            bound=bayes_bound(config.pairs.locomotion_k),
            pose_bound=more["pose_bound"],
            title=f"{held_out.name}: {config.collect.decisions:,} decisions, "
            f"{config.train.updates:,} updates, seed {config.seed}",
        ).savefig(folder / name, dpi=150)
    bound = bayes_bound(config.pairs.locomotion_k).tolist()
    content = {
        "mazes": figures,
        "waypoint_share": dict(zip(map(str, _SHARES_AT), shares, strict=True)),
        "thresholds": {name: asdict(one) for name, one in marks.items()},
        "l_bayes_bound": bound,
    }
    write_text(folder / "report.json", json.dumps(_plain(content), indent=2) + "\n")
    return figures


def _measure(
    networks: Networks,
    validation: Validation,
    maze: MazeConfig,
    held_out: HeldOut,
    config: PretrainConfig,
    *,
    seed: int,
) -> tuple[TCReport, LReport, dict[str, float]]:
    """Both networks in one maze against its truth."""
    metric = MazeMetric(torch.from_numpy(make_layout(maze).open_mask))
    rule = TCPairs(config.pairs.k, config.validate.m)
    test = held_out.draw(rule, _REPORT_PAIRS, seed=seed)
    tc = tc_report(
        validation.similarity(networks, held_out, test),
        test.label,
        pair_truth(metric, *held_out.poses(test)),
        max_action_distance=config.pairs.k,
    )
    way = held_out.draw(LPairs(config.pairs.locomotion_k), _REPORT_PAIRS, seed=seed)
    locomotion = l_report(
        validation.logits(networks, held_out, way),
        way.action,
        way.distance,
        useful_actions(*held_out.poses(way)),
        max_action_distance=config.pairs.locomotion_k,
    )
    train = held_out.draw(rule, _BOUND_PAIRS, seed=seed + 1)
    more = {
        "pose_bound": pose_bound(
            (_pose_features(metric, held_out, train), train.label),
            (_pose_features(metric, held_out, test), test.label),
        ),
        **place_errors(networks, validation, maze, held_out, min_gap=rule.min_distance),
    }
    return tc, locomotion, more


def _pose_features(metric: MazeMetric, held_out: HeldOut, pairs: PairSet) -> Tensor:
    positions, headings = held_out.poses(pairs)
    return pose_features(positions, headings, pair_truth(metric, positions, headings))


def summarize(figures: Mapping[str, Mapping[str, float]], networks: Networks) -> str:
    """The figures of `write_reports` for a reader in a hurry, a line a maze."""
    lines = []
    for name, maze in figures.items():
        by_offset = [
            f"{value:.0%}" for key, value in maze.items() if key.startswith("accuracy_")
        ]
        lines.append(
            f"{name}: TC {maze['accuracy']:.1%} (from true poses "
            f"{maze['pose_bound']:.1%}), AUC {maze['auc']:.3f}, place error "
            f"{maze['place_error']:.1%} (another visit "
            f"{maze['place_error_revisit']:.1%}); L by offset {' / '.join(by_offset)}"
        )
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
