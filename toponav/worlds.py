"""`WorldSpec`: what the other rooms must know of a world; ask it, copy nothing."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What one decision does to a pose, in a world that reports poses.

    Args:
        cell_size: side of a cell in map units.
        step: map units moved in one forward decision.
        turn: degrees turned in one turning decision.
    """

    cell_size: float
    step: float
    turn: float

    @property
    def decisions_per_cell(self) -> float:
        """How many forward decisions cross a cell."""
        return self.cell_size / self.step


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """A world as networks, transforms, policies and metrics see it.

    Every environment carries one as ``env.world``. It is made where the world is: by an
    engine, or from the spaces of a Gymnasium environment.

    Args:
        view_size: height and width of a view in pixels.
        actions: the name of each discrete action, in the order of their numbers.
        tics_per_decision: engine tics for which a decision holds its action.
        motion: what a decision does; ``None`` in a world without ground truth: there,
            coverage and the quality of maps are not reported.
        goal_reward: reward for reaching a goal; ``None`` in a world without goals.
        apple_reward: reward for an apple; ``None`` in a world without apples.

    Examples:
        >>> world = WorldSpec(view_size=(64, 64), actions=("left", "right"))
        >>> world.num_actions, world.has_truth
        (2, False)
    """

    view_size: tuple[int, int]
    actions: tuple[str, ...]
    tics_per_decision: int = 1
    motion: Motion | None = None
    goal_reward: float | None = None
    apple_reward: float | None = None

    @property
    def num_actions(self) -> int:
        """Number A of actions."""
        return len(self.actions)

    @property
    def has_truth(self) -> bool:
        """Whether environments of this world can report poses and cells."""
        return self.motion is not None
