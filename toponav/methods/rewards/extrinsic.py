"""Extrinsic: pays what the world's task pays, and nothing for curiosity."""

from toponav.builders import RewardMethod
from toponav.keys import REWARD


class ExtrinsicMethod(RewardMethod):
    """The task's own reward: in mazes, apples and the goal.

    Without any, as with ``maze.apples=0 maze.goal=false``, it is 0 in every decision.

    Reference:
        The paper, "Fine-tuning with extrinsic rewards" (Fig. 18, Table 6).
    """

    reward_key = REWARD
