"""Maps from settings: their rules, their thresholds, and the network behind them."""

from collections.abc import Mapping
from dataclasses import fields

import torch
from torch import Tensor

from toponav.config import MapConfig, require
from toponav.graph import MapRules, TopologicalMap, Trajectories, Views
from toponav.modules import TCNetwork
from toponav.worlds import WorldSpec


def make_map(
    config: MapConfig,
    tc: TCNetwork,
    thresholds: Mapping[str, float],
    *,
    world: WorldSpec,
    views: Views | None = None,
    keep_walks: bool = False,
) -> TopologicalMap:
    """An empty map of a world; ``tc`` embeds and compares, in ``eval()`` mode.

    ``views`` say where the waypoints' views are kept, in memory by default, and
    ``keep_walks`` whether all that the map is fed is kept, to `consolidate` it.
    Raises `SettingsError` if a threshold was not calibrated or does not fit the other.
    """
    threshold, reach = map_thresholds(config, thresholds)
    names = {field.name for field in fields(MapRules)}
    settings = {name: value for name, value in vars(config).items() if name in names}
    settings |= {"tc_threshold": threshold, "tc_reach": reach}
    rules = MapRules(**settings)
    effects = action_effects(world)
    return empty_map(
        tc,
        rules,
        goal_reward=world.goal_reward,
        turns=None if effects is None else effects[:, 2],
        views=views,
        walks=Trajectories() if keep_walks else None,
    )


def action_effects(world: WorldSpec) -> Tensor | None:
    """What each action does in free space, float32 ``[A, 3]``, if it is known.

    Steps ahead and to the left, 1 for the fastest action, and degrees to the left.
    """
    if world.motion is None:
        return None
    effects = torch.tensor(world.motion.effects)
    effects[:, :2] /= world.motion.step
    return effects


def map_thresholds(
    config: MapConfig, thresholds: Mapping[str, float]
) -> tuple[float, float]:
    """``tc_threshold`` and ``tc_reach`` of a map; raises as `make_map`."""
    threshold, reach = (
        threshold_of(f"map.{name}", getattr(config, name), {"auto": name}, thresholds)
        for name in ("tc_threshold", "tc_reach")
    )
    if config.tc_reach == "auto":
        reach = min(reach, threshold)
    rule = f"map.tc_reach must be at most map.tc_threshold = {threshold:g}"
    require(reach <= threshold, rule, f"{reach:g}")
    return threshold, reach


def threshold_of(
    setting: str, value: str, words: Mapping[str, str], thresholds: Mapping[str, float]
) -> float:
    """The threshold that a setting gives, below 1.

    ``value`` is a number, or one of ``words`` for one of the calibrated ``thresholds``;
    `SettingsError` if there is none.

    Examples:
        >>> threshold_of("map.tc_reach", "auto", {"auto": "reach"}, {"reach": 0.8})
        0.8
        >>> threshold_of("map.tc_reach", "0.7", {"auto": "reach"}, {})
        0.7
    """
    name = words.get(value)
    if name is None:
        return float(value)
    rule = f"{setting} must be a number with networks that have no calibrated {name}"
    require(name in thresholds, rule, value)
    return min(float(thresholds[name]), 0.999)


def empty_map(
    tc: TCNetwork,
    rules: MapRules,
    *,
    goal_reward: float | None = None,
    turns: Tensor | None = None,
    views: Views | None = None,
    walks: Trajectories | None = None,
) -> TopologicalMap:
    """A map by a TC-network on any device and in any precision."""

    def to_network(values: Tensor) -> Tensor:
        return values.to(next(tc.parameters()))

    def embed(views: Tensor) -> Tensor:
        return tc.embed(views.to(next(tc.parameters()).device)).float().cpu()

    def compare(embedding: Tensor, prepared: Tensor) -> Tensor:
        return tc.compare_prepared(to_network(embedding), to_network(prepared)).cpu()

    def prepare(memory: Tensor) -> Tensor:
        return tc.prepare_memory(to_network(memory)).float().cpu()

    return TopologicalMap(
        embed,
        compare,
        rules,
        prepare=prepare,
        goal_reward=goal_reward,
        turns=turns,
        views=views,
        walks=walks,
    )
