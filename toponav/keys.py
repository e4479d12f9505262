"""Every tensordict key of the package: name, dtype, shape, unit, writer, readers.

Shapes leave out the batch dimensions ``*B``. A *decision* is one agent step of
four engine tics. Keys that TorchRL defines (``action``, ``reward``, ``done``,
``terminated``, ``truncated``) keep their TorchRL meaning and are listed so that
this file is the whole dictionary.

Everything under ``PRIVILEGED`` is the truth about the maze (pose, cell, slots,
coverage). Evaluation reads it; an agent never does.
"""

from tensordict import NestedKey

# --- the environment -------------------------------------------------------
#: uint8 [120, 160, 3]; first-person view, RGB. Env -> encoders, figures.
PIXELS: NestedKey = "pixels"
#: int64 []; 0 forward, 1 backward, 2 left, 3 right, 4 forward+left,
#: 5 forward+right. Policy -> env, L-network.
ACTION: NestedKey = "action"
#: float32 [1]; the task's reward: +1 an apple, +10 the goal. Env -> evaluation.
REWARD: NestedKey = "reward"
#: bool [1]; ``terminated`` or ``truncated``. Env -> collectors.
DONE: NestedKey = "done"
#: bool [1]; always false: neither a goal nor an apple ends an episode.
TERMINATED: NestedKey = "terminated"
#: bool [1]; the episode's clock ran out, or its engine was lost.
TRUNCATED: NestedKey = "truncated"
#: float32 [H, W]; planar depth in map units (128 to a cell). Env -> Nav A3C.
DEPTH: NestedKey = "depth"
#: float32 [6]; forward, left, up in map units per decision, then yaw, pitch,
#: roll in degrees per decision, agent's frame. Env -> Nav A3C.
VELOCITY: NestedKey = "velocity"

# --- the truth, for evaluation only ----------------------------------------
#: The nested key under which all privileged entries live.
PRIVILEGED: str = "privileged"
#: float32 [2]; x (east) and y (north) in map units.
POSITION: NestedKey = (PRIVILEGED, "position")
#: float32 [1]; degrees in [0, 360), 0 is east, counter-clockwise.
HEADING: NestedKey = (PRIVILEGED, "heading")
#: int64 [2]; row and column of the layout text in which the agent stands.
CELL: NestedKey = (PRIVILEGED, "cell")
#: int64 [2]; row and column of the goal, (-1, -1) without one.
GOAL_CELL: NestedKey = (PRIVILEGED, "goal_cell")
#: bool [S]; which of the layout's S slots are closed, in the layout's order.
BLOCKED: NestedKey = (PRIVILEGED, "blocked")
#: bool [1]; the agent touched the goal in this decision and was put elsewhere.
RESPAWNED: NestedKey = (PRIVILEGED, "respawned")

# --- Coverage (transforms/coverage.py), evaluation only --------------------
#: float32 [1]; share of the open cells visited in this episode, in [0, 1].
COVERAGE: NestedKey = (PRIVILEGED, "coverage")
#: float32 [1]; number of cells entered for the first time in this decision.
COVERAGE_REWARD: NestedKey = (PRIVILEGED, "coverage_reward")
#: int64 [L]; decisions it took to reach each coverage level, -1 if not yet.
DECISIONS_TO_COVERAGE: NestedKey = (PRIVILEGED, "decisions_to_coverage")

# --- TC-network and L-network ----------------------------------------------
#: float32 [D]; a network's embedding of one view. Encoders -> comparators.
EMBEDDING: NestedKey = "embedding"
#: uint8 [120, 160, 3]; the earlier and the later view of a training pair.
ANCHOR: NestedKey = "anchor"
OTHER: NestedKey = "other"
#: float32 []; 1: at most k decisions apart, 0: at least M*k. TC pairs.
LABEL: NestedKey = "label"
#: float32 []; weight of a pair in its loss. Pair mining -> losses.
WEIGHT: NestedKey = "weight"
#: int64 []; tells the episodes of one batch apart. Chunks -> pair mining.
EPISODE: NestedKey = "episode"
#: int64 []; number of the decision within its episode. Chunks -> pair mining.
STEP: NestedKey = "step"
#: int64 []; a number per episode, unique over all workers. TorchRL's collectors
#: -> pair sampling.
TRAJECTORY: NestedKey = ("collector", "traj_ids")
#: float32 []; TC-network's logit of "at most k decisions apart". Network -> TCLoss.
LOGIT: NestedKey = "logit"
#: float32 [6]; L-network's logits of the actions. Network -> LLoss, navigator.
LOGITS: NestedKey = "logits"
