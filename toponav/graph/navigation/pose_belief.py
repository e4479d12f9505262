"""`PoseBelief`: where agents may be on a map whose waypoints have poses."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.graph.poses import decisions_apart, fastest_turn, moved

#: Standard deviations of what poses change by themselves in a decision, and around a
#: waypoint that they are drawn at: steps, steps and degrees.
_DRIFT, _AROUND = (0.15, 0.15, 1.0), (1.0, 1.0, 8.0)
#: Waypoints of a view that count, the most likely ones.
_PLACES = 16
#: Poses of each agent that judge around which of all most others lie; standard
#: deviation of what is around, in decisions, and how far the mean of them reaches.
_JUDGES, _CROWD, _REACH = 64, 2.0, 4.0
#: Likelihood of a pose at least: what can be drawn is above 0.
_LEAST = torch.finfo(torch.float32).tiny


@dataclass(frozen=True, kw_only=True)
class BeliefRules:
    """How a belief follows actions and views. Lengths are decisions in free space."""

    poses: int = 200  # of each agent
    #: Standard deviation of the distance from where a view says that it is to a pose
    #: that it speaks for.
    spread: float = 1.5
    floor: float = 0.02  # likelihood of any view at any pose
    #: Exponent of likelihoods, since successive views say nearly the same.
    power: float = 0.7
    stopped: float = 0.2  # share of the moves that something stops on the way
    still: float = 0.8  # the same, of those after a stopped one: walls stay
    lost: float = 0.02  # share of the poses that are drawn again by the view alone

    def __post_init__(self) -> None:
        for name in ("floor", "power", "stopped", "still", "lost"):
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {value}")
        if self.poses < 1:
            raise ValueError(f"poses must be at least 1, got {self.poses}")
        if self.spread <= 0:
            raise ValueError(f"spread must be above 0, got {self.spread}")


class PoseBelief:
    """P poses that each of N agents may have, followed by its actions and views.

    In each decision poses move as the last action does in free space, some of them less
    far, since walls stop agents, mostly again and again; then those stay that the view
    speaks for, by the waypoints that it may be at. A few are drawn again, so that an
    agent that is mistaken finds itself.

    Reference:
        Beyond the paper. Monte Carlo localisation with added poses: Thrun, Burgard and
        Fox, "Probabilistic Robotics" (2005), chapter 8.

    Args:
        waypoints: poses of the map's waypoints, ``[W, 3]``: steps, steps and degrees.
        effects: of the actions in free space, ``[A, 3]``: steps ahead and to the left,
            and degrees to the left.
        rules: its choices.
        num_agents: N.
        generator: of all draws.
    """

    def __init__(
        self,
        waypoints: Tensor,
        effects: Tensor,
        rules: BeliefRules,
        num_agents: int,
        generator: torch.Generator,
    ) -> None:
        self.waypoints = waypoints
        self.effects = effects
        self.turn = fastest_turn(effects)
        self.rules = rules
        self.generator = generator
        #: float32 ``[N, P, 3]``.
        self.poses = torch.zeros(num_agents, rules.poses, 3)
        # Whether something stopped the last move, bool [N, P].
        self._stopped = torch.zeros(num_agents, rules.poses, dtype=torch.bool)
        self._is_new = torch.ones(num_agents, dtype=torch.bool)

    def forget(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, may be anywhere."""
        self._is_new |= agents

    def update(
        self, action: Tensor, chance: Tensor, offsets: Tensor | None = None
    ) -> None:
        """Follow the last ``action`` ``[N]`` and the view that came after it.

        ``chance`` ``[N, W]`` is that the view is near each waypoint, and ``offsets``
        ``[N, W, 3]`` are from there to where it then is, in steps, steps and degrees; 0
        by default.
        """
        rules, number = self.rules, self.rules.poses
        chance, nodes = chance.topk(min(_PLACES, chance.shape[1]))
        # Some of few poses are one at least: without any it would never find itself.
        lost = max(round(rules.lost * number), rules.lost > 0)
        is_lost = torch.arange(number) < lost
        redrawn = (is_lost | self._is_new.unsqueeze(1)).unsqueeze(2)
        near = self.waypoints[nodes]
        if offsets is not None:
            near = near + offsets.gather(1, nodes.unsqueeze(2).expand_as(near))
        poses = torch.where(redrawn, self._draw(near, chance), self._move(action))
        apart = decisions_apart(poses.unsqueeze(2), near.unsqueeze(1), self.turn)
        speaks = (-0.5 * (apart / rules.spread).square()).exp() * chance.unsqueeze(1)
        likelihood = (speaks.sum(2) + rules.floor).pow(rules.power)
        # Without a floor a view may speak for none: then all are as likely.
        drawn = self._multinomial(likelihood.clamp(min=_LEAST))
        self.poses = poses.gather(1, drawn.unsqueeze(2).expand(-1, -1, 3))
        self._stopped = (self._stopped & ~redrawn.squeeze(2)).gather(1, drawn)
        self._is_new[:] = False

    def estimate(self) -> Tensor:
        """The pose of each agent, ``[N, 3]``: the mean where most of its poses are."""
        judges = self.poses[:, None, :_JUDGES]
        apart = decisions_apart(self.poses.unsqueeze(2), judges, self.turn)
        best = (-0.5 * (apart / _CROWD).square()).exp().sum(2).argmax(1)
        centre = self.poses[torch.arange(len(best)), best].unsqueeze(1)
        near = decisions_apart(self.poses, centre, self.turn) < _REACH
        gap = self.poses - centre
        gap[..., 2] = (gap[..., 2] + 180) % 360 - 180
        mean = (gap * near.unsqueeze(2)).sum(1) / near.sum(1, keepdim=True)
        return centre.squeeze(1) + mean

    def _move(self, action: Tensor) -> Tensor:
        effects = self.effects[action].unsqueeze(1).repeat(1, self.rules.poses, 1)
        draws = torch.rand(2, *effects.shape[:2], generator=self.generator)
        chance = torch.where(self._stopped, self.rules.still, self.rules.stopped)
        # A turn on the spot tells nothing about what is ahead.
        moves = effects[..., :2].norm(dim=2) > 0
        self._stopped = torch.where(moves, draws[1] < chance, self._stopped)
        # A stopped move may end anywhere on its way.
        share = draws[0].masked_fill(~self._stopped, 1.0)
        effects[..., :2] *= share.unsqueeze(2)
        return moved(self.poses, effects) + self._noise(_DRIFT)

    def _draw(self, near: Tensor, chance: Tensor) -> Tensor:
        # Of a view that may be anywhere, chances can all be 0.
        drawn = self._multinomial(chance + 1e-6).unsqueeze(2)
        return near.gather(1, drawn.expand(-1, -1, 3)) + self._noise(_AROUND)

    def _multinomial(self, chance: Tensor) -> Tensor:
        return torch.multinomial(
            chance, self.rules.poses, replacement=True, generator=self.generator
        )

    def _noise(self, deviation: tuple[float, ...]) -> Tensor:
        drawn = torch.randn(self.poses.shape, generator=self.generator)
        return drawn * torch.tensor(deviation)
