"""Two games of ours for `sanity_navigation`: batches on tensors, seen from above.

In `Catch` all that matters is in view. In `Recall` a sign is shown once, and six to
eight decisions later its action is right: more than DQN's four views, less than DRQN's
ten.
"""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from toponav.keys import POLICY_PIXELS
from toponav.worlds import WorldSpec

SIDE, CELL = 36, 4


class Game(EnvBase):
    """A batch of games that are seen from above, 36 x 36 pixels."""

    num_actions: int
    numbers: int  # that a state consists of

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__(batch_size=[num_envs])
        self.generator = torch.Generator().manual_seed(seed)
        shape = (num_envs, 1)
        view = (num_envs, SIDE, SIDE, 3)
        self.observation_spec = Composite(
            {
                POLICY_PIXELS: Unbounded(view, dtype=torch.uint8),
                "state": Unbounded((num_envs, self.numbers), dtype=torch.int64),
            },
            shape=[num_envs],
        )
        self.action_spec = Categorical(self.num_actions, shape=(num_envs,))
        self.reward_spec = Unbounded(shape)
        flag = Binary(1, shape, dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.done_spec = Composite({name: flag for name in names}, shape=[num_envs])

    def start(self, num: int) -> Tensor:
        """States at an episode's start, int64 ``[N, K]``."""
        raise NotImplementedError

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """States after a decision, rewards, and which episodes are over."""
        raise NotImplementedError

    def draw(self, state: Tensor) -> Tensor:
        """Views ``[N, 36, 36, 3]``."""
        raise NotImplementedError

    def numbers_below(self, bound: int, num: int) -> Tensor:
        """Draws from [0, bound)."""
        return torch.randint(bound, (num,), generator=self.generator)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object):
        # TorchRL keeps what goes on.
        state = self.start(self.batch_size[0])
        flags = dict.fromkeys(("done", "terminated", "truncated"), _no(state))
        entries = {POLICY_PIXELS: self.draw(state), "state": state, **flags}
        return TensorDict(entries, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, reward, over = self.move(tensordict["state"], tensordict["action"])
        over = over.unsqueeze(-1)
        flags = {"done": over, "terminated": over, "truncated": _no(state)}
        entries = {POLICY_PIXELS: self.draw(state), "state": state, **flags}
        entries["reward"] = reward.float().unsqueeze(-1)
        return TensorDict(entries, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed or 0)


def _no(state: Tensor) -> Tensor:
    return torch.zeros(len(state), 1, dtype=torch.bool)


class Catch(Game):
    """A ball falls through nine rows; what matters is to be below it at the end."""

    num_actions, numbers = 3, 3

    def start(self, num: int) -> Tensor:
        ball, hand = self.numbers_below(9, num), torch.full((num,), 4)
        return torch.stack([torch.zeros_like(ball), ball, hand], -1)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        row, ball, hand = state.unbind(-1)
        row, hand = row + 1, (hand + action - 1).clamp(0, 8)
        over = row == 8
        reward = torch.where(hand == ball, 1, -1) * over
        return torch.stack([row, ball, hand], -1), reward, over

    def draw(self, state: Tensor) -> Tensor:
        row, ball, hand = state.unbind(-1)
        small = torch.zeros(len(state), 9, 9, dtype=torch.uint8)
        every = torch.arange(len(state))
        small[every, 8, hand] = 127
        small[every, row, ball] = 255
        large = small.repeat_interleave(CELL, 1).repeat_interleave(CELL, 2)
        return large.unsqueeze(-1).repeat(1, 1, 1, 3)


class Recall(Game):
    """A sign, a way without signs, and a junction where the sign's action is right."""

    num_actions, numbers = 2, 3

    def start(self, num: int) -> Tensor:
        sign, length = self.numbers_below(2, num), 6 + self.numbers_below(3, num)
        return torch.stack([sign, torch.zeros_like(sign), length], -1)

    def move(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        sign, now, length = state.unbind(-1)
        over = now == length
        reward = torch.where(action == sign, 1, -1) * over
        return torch.stack([sign, now + 1, length], -1), reward, over

    def draw(self, state: Tensor) -> Tensor:
        sign, now, length = state.unbind(-1)
        views = torch.full((len(state), SIDE, SIDE, 3), 60, dtype=torch.uint8)
        half = torch.arange(SIDE) // (SIDE // 2)
        shown = (now == 0).unsqueeze(-1) & (half == sign.unsqueeze(-1))
        views[..., 0] = torch.where(shown.unsqueeze(1), 255, 60)
        views[now == length] = 255
        return views


class GameWorld:
    """What a learner asks of a world."""

    senses = ()

    def __init__(self, game: type[Game]) -> None:
        self.game, self.name, self.layout = game, game.__name__, None
        actions = tuple(f"action {number}" for number in range(game.num_actions))
        self.spec = WorldSpec(view_size=(SIDE, SIDE), actions=actions)

    def make_env(self, *, batch_size: int, seed: int) -> Game:
        """A batch of games."""
        return self.game(batch_size, seed)
