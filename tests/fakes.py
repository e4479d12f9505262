"""A maze without an engine: the keys and the movement of the real one, in torch."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from toponav import keys
from toponav.worlds import Effect, Motion, WorldSpec

# Four tics that turn 5 degrees and then move: the chord points 12.5 degrees aside.
_CURVE = 33.1 * math.cos(math.radians(12.5)), 33.1 * math.sin(math.radians(12.5))
#: Its world: the cells, the motion and the actions of the real one, small views.
WORLD = WorldSpec(
    view_size=(4, 4),
    actions=(
        *("forward", "backward", "left", "right"),
        *("forward+left", "forward+right"),
    ),
    motion=Motion(
        cell_size=128.0,
        effects=(
            *(Effect(ahead=33.1), Effect(ahead=-33.1)),
            *(Effect(turn=20.0), Effect(turn=-20.0)),
            *(Effect(*_CURVE, turn=20.0), Effect(_CURVE[0], -_CURVE[1], turn=-20.0)),
        ),
    ),
    goal_reward=10.0,
)
CELL_SIZE = 128.0
RADIUS = 16.0
TURN = 5.0  # degrees per tic
TICS = 4
# Doom's friction 0.90625 and the player's own factor 0.5, each tic; the thrust
# gives 33.1 units per decision in the long run and a coast of 6.9 units.
KEEP = 0.90625 * 0.5
THRUST = 33.1 / TICS * (1 - KEEP)
GOAL_REACH = 36.0

# Thrust and turn of each of the six actions.
_FORWARD = torch.tensor([1.0, -1.0, 0.0, 0.0, 1.0, 1.0])
_TURN = torch.tensor([0.0, 0.0, TURN, -TURN, TURN, -TURN])

TINY = ("*****", "*  a*", "* * *", "*   *", "*****")

MAZES = {
    "maze1": """
**************
***   ********
***          *
***   ****** *
****b******* *
**** ******* *
*    ******* *
* ** ******* *
* **a******* *
* ** ******* *
*            *
**** *********
***   ********
**************""",
    "maze2": """
*************
*   *   *   *
** *** *** **
** *** *** **
*           *
** *** *** **
** *** *** **
*   *   *   *
*************""",
    "maze3": """
*************
*     *     *
* *** * *** *
* *   *   * *
* * ***** * *
*           *
*** * * * ***
*   * *     *
* *** *** * *
*     *   * *
*************""",
}


def parse(text: str | Sequence[str]) -> tuple[Tensor, dict[str, tuple[int, int]]]:
    """Return the open mask, bool ``[rows, cols]``, and the cell of each slot."""
    lines = text.strip("\n").split("\n") if isinstance(text, str) else text
    mask = torch.tensor([[letter != "*" for letter in line] for line in lines])
    slots = {
        letter: (row, column)
        for row, line in enumerate(lines)
        for column, letter in enumerate(line)
        if letter not in "* "
    }
    return mask, dict(sorted(slots.items()))


class FakeMaze(EnvBase):
    """Batched maze with the real keys; the view is a colour that names the pose."""

    def __init__(
        self,
        layout: str | Sequence[str] = TINY,
        *,
        batch_size: Sequence[int] = (),
        max_decisions: int = 12,
        blocked: Sequence[str] = (),
        image_size: tuple[int, int] = (12, 16),
        float_pixels: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__(batch_size=torch.Size(batch_size))
        self.mask, self.slots = parse(layout)
        self.max_decisions = max_decisions
        self.image_size = image_size
        self.world = replace(WORLD, view_size=image_size)
        self.float_pixels = float_pixels
        closed = torch.tensor([s in blocked for s in self.slots], dtype=torch.bool)
        self.blocked = closed.expand(*self.batch_size, -1).clone()
        self.slot_cells = torch.tensor(list(self.slots.values())).reshape(-1, 2)
        self.start_cells = torch.tensor(
            [c for c in self.mask.nonzero().tolist() if tuple(c) not in self._slot_set]
        )
        self._make_specs()
        self._set_seed(seed)
        shape = self.batch_size
        self.position = torch.zeros(*shape, 2)
        self.velocity = torch.zeros(*shape, 2)
        self.heading = torch.zeros(shape)
        self.goal = torch.zeros(*shape, 2, dtype=torch.int64)
        self.clock = torch.zeros(shape, dtype=torch.int64)

    @property
    def _slot_set(self) -> set[tuple[int, int]]:
        return set(self.slots.values())

    def _make_specs(self) -> None:
        shape, slots = self.batch_size, len(self.slots)
        image = (*shape, *self.image_size, 3)
        last = (torch.tensor(self.mask.shape) - 1).expand(*shape, 2)
        pixels = (
            Bounded(0.0, 1.0, shape=image)
            if self.float_pixels
            else Bounded(0, 255, shape=image, dtype=torch.uint8)
        )
        privileged = Composite(
            position=Unbounded(shape=(*shape, 2)),
            heading=Bounded(0.0, 360.0, shape=(*shape, 1)),
            cell=Bounded(0, last, shape=(*shape, 2), dtype=torch.int64),
            goal_cell=Bounded(-1, last, shape=(*shape, 2), dtype=torch.int64),
            blocked=Binary(slots, shape=(*shape, slots), dtype=torch.bool),
            respawned=Binary(1, shape=(*shape, 1), dtype=torch.bool),
            shape=shape,
        )
        self.observation_spec = Composite(
            {keys.PIXELS: pixels, keys.PRIVILEGED: privileged}, shape=shape
        )
        self.action_spec = Categorical(
            WORLD.num_actions, shape=shape, dtype=torch.int64
        )
        self.reward_spec = Unbounded(shape=(*shape, 1))
        done = Binary(1, shape=(*shape, 1), dtype=torch.bool)
        self.full_done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=shape
        )

    def _set_seed(self, seed: int | None) -> None:
        self.generator = torch.Generator().manual_seed(seed or 0)

    def centre(self, cell: Tensor) -> Tensor:
        """Return x and y of the middle of ``cell``, ``[*B, 2]``."""
        row, column = cell.unbind(-1)
        x, y = column + 0.5, self.mask.shape[0] - row - 0.5
        return torch.stack([x, y], -1) * CELL_SIZE

    def cell(self) -> Tensor:
        column, up = (self.position / CELL_SIZE).floor().long().unbind(-1)
        return torch.stack([self.mask.shape[0] - 1 - up, column], -1)

    def place(self, rows: Tensor) -> None:
        """Put the agents of ``rows`` at new random poses."""
        num = len(self.start_cells)
        pick = torch.randint(num, self.batch_size, generator=self.generator)
        jitter = torch.rand(*self.batch_size, 2, generator=self.generator) - 0.5
        start = self.centre(self.start_cells[pick]) + 0.4 * CELL_SIZE * jitter
        angle = 360 * torch.rand(self.batch_size, generator=self.generator)
        self.position = torch.where(rows.unsqueeze(-1), start, self.position)
        self.velocity = self.velocity * ~rows.unsqueeze(-1)
        self.heading = torch.where(rows, angle, self.heading)

    def _reset(self, tensordict: TensorDictBase | None = None) -> TensorDictBase:
        rows = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        self.place(rows)
        num = len(self.start_cells)
        pick = torch.randint(num, self.batch_size, generator=self.generator)
        goal = self.start_cells[pick]
        self.goal = torch.where(rows.unsqueeze(-1), goal, self.goal)
        self.clock = self.clock * ~rows
        return self._observe(torch.zeros(self.batch_size, dtype=torch.bool))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict[keys.ACTION]
        for _ in range(TICS):
            self._tic(_FORWARD[action] * THRUST, _TURN[action])
        self.clock = self.clock + 1
        away = (self.position - self.centre(self.goal)).abs()
        touched = (away < GOAL_REACH).all(-1)
        self.place(touched)
        result = self._observe(touched)
        result[keys.REWARD] = 10.0 * touched.float().unsqueeze(-1)
        return result

    def _tic(self, thrust: Tensor, turn: Tensor) -> None:
        self.heading = (self.heading + turn) % 360
        angle = self.heading * (math.pi / 180)
        ahead = torch.stack([angle.cos(), angle.sin()], -1)
        self.velocity = KEEP * self.velocity + thrust.unsqueeze(-1) * ahead
        # One axis after the other: what is left of a blocked move is a slide.
        for axis in (0, 1):
            moved = self.position.clone()
            moved[..., axis] += self.velocity[..., axis]
            free = self.is_free(moved).unsqueeze(-1)
            self.position = torch.where(free, moved, self.position)
            self.velocity[..., axis] *= free[..., 0]

    def is_free(self, position: Tensor) -> Tensor:
        """Return whether the agent's box of radius 16 touches no wall."""
        rows = self.mask.shape[0]
        free = torch.ones(self.batch_size, dtype=torch.bool)
        for dx in (-RADIUS, RADIUS):
            for dy in (-RADIUS, RADIUS):
                corner = (position + torch.tensor([dx, dy])) / CELL_SIZE
                column, up = corner.floor().long().unbind(-1)
                row = rows - 1 - up
                closed = torch.zeros_like(free)
                for slot, (slot_row, slot_col) in enumerate(self.slot_cells.tolist()):
                    here = (row == slot_row) & (column == slot_col)
                    closed |= here & self.blocked[..., slot]
                free &= self.mask[row, column] & ~closed
        return free

    def _observe(self, respawned: Tensor) -> TensorDictBase:
        shape = self.batch_size
        scale = torch.tensor([0.4, 0.3]) / CELL_SIZE
        colour = torch.cat(
            [self.position * scale, self.heading.unsqueeze(-1) / 360], -1
        )
        colour = colour.remainder(1.0)
        if not self.float_pixels:
            colour = (colour * 255).to(torch.uint8)
        pixels = colour[..., None, None, :].expand(*shape, *self.image_size, 3).clone()
        truncated = (self.clock >= self.max_decisions).unsqueeze(-1)
        return TensorDict(
            {
                keys.PIXELS: pixels,
                keys.POSITION: self.position.clone(),
                keys.HEADING: self.heading.unsqueeze(-1).clone(),
                keys.CELL: self.cell(),
                keys.GOAL_CELL: self.goal.clone(),
                keys.BLOCKED: self.blocked.clone(),
                keys.RESPAWNED: respawned.unsqueeze(-1),
                keys.TRUNCATED: truncated,
                keys.TERMINATED: torch.zeros_like(truncated),
                keys.DONE: truncated.clone(),
            },
            batch_size=shape,
        )
