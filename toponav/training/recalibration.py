"""`Recalibration`: thresholds for networks that continue training."""

from collections.abc import Mapping
from contextlib import AbstractContextManager

import torch
from torch import Tensor

from toponav.builders import Networks, World, collect_walks, one_thread, seed_of
from toponav.config import ExploreConfig
from toponav.graph import WalkWaypoints, calibrate_reach, calibrate_share
from toponav.keys import NETWORK_PIXELS

#: Random walks that no training sees, and decisions in each.
_WALKS, _DECISIONS = 6, 600
#: Views embedded at once.
_VIEWS = 64
#: Calibrated to a share of waypoints; ``tc_reach`` follows from pairs of close views.
_BY_SHARE = ("tc_threshold", "reward_threshold")
_TOLERANCE = 0.02  # of the share


class Recalibration:
    """Finds the thresholds at which new weights do what the old ones did.

    A few random walks, ``[W, T, H, W, 3]``, keep as many waypoints as they did by the
    weights and thresholds of ``networks`` when this was built. So few walks would give
    another share than pre-training's many long ones; the same walks compare.

    Args:
        networks: calibrated ones, or others, which stay without thresholds.
        k: decisions between close views.
        autocast: the precision to embed in.
    """

    def __init__(
        self,
        walks: Tensor,
        networks: Networks,
        *,
        k: int,
        autocast: AbstractContextManager[None],
    ) -> None:
        self.walks = walks
        self.k = k
        self.autocast = autocast
        #: Waypoints per view, by the name of the threshold.
        self.shares: dict[str, float] = {}
        if networks.thresholds:
            walked, found = self._compare(networks), networks.thresholds
            self.shares = {name: _mean_share(walked, found[name]) for name in _BY_SHARE}

    def __call__(
        self, networks: Networks, old: Mapping[str, float]
    ) -> dict[str, float]:
        """Thresholds for networks in ``eval()`` mode; an old one stays if it does."""
        if not self.shares:
            return {}
        walked, found = self._compare(networks), dict(old)
        for name, share in self.shares.items():
            if abs(_mean_share(walked, old[name]) - share) > _TOLERANCE * share:
                # Nothing is calibrated to a share of one.
                target = min(share, 0.999)
                found[name] = calibrate_share(walked, target_share=target).threshold
        reach = calibrate_reach(
            walked, tc_threshold=found["tc_threshold"], max_action_distance=self.k
        )
        return found | {"tc_reach": reach.threshold}

    @torch.no_grad()
    def _compare(self, networks: Networks) -> list[WalkWaypoints]:
        views = self.walks.flatten(0, 1).split(_VIEWS)
        with self.autocast:
            parts = [networks.tc.embed(some.to(networks.device)) for some in views]
        embeddings = torch.cat(parts).float().split(self.walks.shape[1])
        with one_thread():
            return [WalkWaypoints(one, networks.tc) for one in embeddings]


def _mean_share(walks: list[WalkWaypoints], threshold: float) -> float:
    return sum(walk.share(threshold) for walk in walks) / len(walks)


def walk_for_calibration(settings: ExploreConfig, world: World) -> Tensor:
    """Views of random walks, ``[W, T, H, W, 3]``; a run that resumes sees the same."""
    frames = collect_walks(
        world,
        _WALKS,
        min(_DECISIONS, world.episode_length),
        seed=seed_of(settings.seed, _WALKS),
        halve=settings.model.halve,
    )
    views: Tensor = frames.get(NETWORK_PIXELS)
    return views
