"""`Recalibration`: thresholds for networks that continue training."""

from collections.abc import Mapping
from contextlib import AbstractContextManager

import torch

from toponav.builders import Networks, World, collect_walks, one_thread, seed_of
from toponav.config import ExploreConfig
from toponav.data import HeldOut
from toponav.graph import WalkWaypoints, calibrate_reach, calibrate_share

#: Random walks that no training sees, and decisions in each.
_WALKS, _DECISIONS = 6, 600
#: Views embedded at once.
_VIEWS = 64
#: Calibrated to a share of waypoints, and whether their memory ends with an episode;
#: ``tc_reach`` follows from pairs of close views.
_BY_SHARE = {"tc_threshold": False, "reward_threshold": True}
_TOLERANCE = 0.02  # of the share


class Recalibration:
    """Finds the thresholds at which new weights do what the old ones did.

    A few random walks keep as many waypoints as they did by the weights and thresholds
    of ``networks`` when this was built. So few walks would give another share than
    pre-training's many long ones; the same walks compare.

    Args:
        walks: of views; their actions are not read.
        networks: calibrated ones, or others, which stay without thresholds.
        k: decisions between close views.
        autocast: the precision to embed in.
    """

    def __init__(
        self,
        walks: HeldOut,
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
            self.shares = {
                name: _mean_share(walked, found[name], episodic=episodic)
                for name, episodic in _BY_SHARE.items()
            }

    def __call__(
        self, networks: Networks, old: Mapping[str, float]
    ) -> dict[str, float]:
        """Thresholds for networks in ``eval()`` mode; an old one stays if it does."""
        if not self.shares:
            return {}
        walked, found = self._compare(networks), dict(old)
        for name, share in self.shares.items():
            episodic = _BY_SHARE[name]
            now = _mean_share(walked, old[name], episodic=episodic)
            if abs(now - share) > _TOLERANCE * share:
                # Nothing is calibrated to a share of one.
                found[name] = calibrate_share(
                    walked, target_share=min(share, 0.999), episodic=episodic
                ).threshold
        reach = calibrate_reach(
            walked, tc_threshold=found["tc_threshold"], max_action_distance=self.k
        )
        return found | {"tc_reach": reach.threshold}

    @torch.no_grad()
    def _compare(self, networks: Networks) -> list[WalkWaypoints]:
        views = self.walks.pixels.split(_VIEWS)
        with self.autocast:
            parts = [networks.tc.embed(some.to(networks.device)) for some in views]
        entries = torch.cat(parts).float(), self.walks.episode
        each = zip(*(one.split(self.walks.length) for one in entries), strict=True)
        with one_thread():
            return [WalkWaypoints(seen, networks.tc, episode) for seen, episode in each]


def _mean_share(
    walks: list[WalkWaypoints], threshold: float, *, episodic: bool
) -> float:
    return sum(walk.share(threshold, episodic=episodic) for walk in walks) / len(walks)


def walk_for_calibration(settings: ExploreConfig, world: World) -> HeldOut:
    """Random walks that no training sees; a run that resumes sees the same."""
    frames = collect_walks(
        world,
        _WALKS,
        min(_DECISIONS, world.episode_length),
        seed=seed_of(settings.seed, _WALKS),
        halve=settings.model.halve,
    )
    return HeldOut(frames, name=world.name)
