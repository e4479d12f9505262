"""`WorldSpec`: the numbers of a world, which no other file copies."""

from dataclasses import dataclass
from typing import NamedTuple


class Effect(NamedTuple):
    """Where a decision leads in free space, seen from where the agent stood."""

    ahead: float = 0.0  # map units
    left: float = 0.0  # map units
    turn: float = 0.0  # degrees to the left


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What decisions do to a pose, in a world that reports poses."""

    cell_size: float  # side of a cell in map units
    effects: tuple[Effect, ...]  # of each action

    @property
    def step(self) -> float:
        """Map units that the fastest action goes ahead."""
        return max(effect.ahead for effect in self.effects)

    @property
    def turn(self) -> float:
        """Degrees that the fastest action turns; all round if none turns."""
        return max(abs(effect.turn) for effect in self.effects) or 360.0

    @property
    def decisions_per_cell(self) -> float:
        """How many forward decisions cross a cell."""
        return self.cell_size / self.step


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """A world as networks, transforms, policies and metrics see it.

    Every environment carries one as ``env.world``. It is made where the world is: by an
    engine, or from the spaces of a Gymnasium environment.

    Examples:
        >>> world = WorldSpec(view_size=(64, 64), actions=("left", "right"))
        >>> world.num_actions, world.has_truth
        (2, False)
    """

    view_size: tuple[int, int]  # height and width in pixels
    actions: tuple[str, ...]  # the name of each, in the order of their numbers
    motion: Motion | None = None  # none in a world without ground truth
    engine: str | None = None  # what draws it; none outside the mazes
    #: Side of a square that counts as one place, in a world of which positions alone
    #: are known.
    place_size: float | None = None
    goal_reward: float | None = None  # for reaching a goal; none without goals
    apple_reward: float | None = None  # none without apples

    def __post_init__(self) -> None:
        actions, motion = len(self.actions), self.motion
        if motion and len(motion.effects) != actions:
            number = len(motion.effects)
            raise ValueError(f"effects must be one of each action, got {number}")

    @property
    def num_actions(self) -> int:
        """Number A of actions."""
        return len(self.actions)

    @property
    def has_truth(self) -> bool:
        """Whether environments of this world can report poses and cells."""
        return self.motion is not None

    @property
    def has_positions(self) -> bool:
        """Whether environments can report at least the agent's position."""
        return self.has_truth or self.place_size is not None
