"""`WorldSpec`: what the other rooms must know of a world; ask it, copy nothing."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What one decision does to a pose, in a world that reports poses."""

    cell_size: float  # side of a cell in map units
    step: float  # map units moved in one forward decision
    turn: float  # degrees turned in one turning decision

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
    tics_per_decision: int = 1  # of the engine, for which an action is held
    motion: Motion | None = None  # none in a world without ground truth
    goal_reward: float | None = None  # for reaching a goal; none without goals
    apple_reward: float | None = None  # none without apples

    @property
    def num_actions(self) -> int:
        """Number A of actions."""
        return len(self.actions)

    @property
    def has_truth(self) -> bool:
        """Whether environments of this world can report poses and cells."""
        return self.motion is not None
