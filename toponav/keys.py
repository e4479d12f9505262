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
#: float32 [6]; logits of the actions. L-network -> LLoss, navigator;
#: ActorCritic -> its losses.
LOGITS: NestedKey = "logits"

# --- exploration: novelty (transforms/waypoint_memory.py and rewards) -------
#: int64 [1]; index of the waypoint that the view is mapped to; a view that becomes
#: a waypoint is mapped to itself; -1 for a view that is mapped to none.
#: WaypointMemory -> figures.
WAYPOINT: NestedKey = "waypoint"
#: float32 [1]; similarity of the view to its nearest waypoint before the view was
#: added, in [0, 1]. WaypointMemory -> TemporalDistanceReward.
SIMILARITY: NestedKey = "similarity"
#: bool [1]; the view is like no waypoint, whether or not it becomes one.
#: WaypointMemory -> figures.
NOVEL: NestedKey = "novel"
#: bool [1]; the view became a waypoint in this decision. WaypointMemory -> rewards.
BORN: NestedKey = "born"
#: int64 [1]; visits of the waypoint that the view is mapped to, this one included;
#: 0 if the decision is no visit. WaypointMemory -> CountReward.
VISITS: NestedKey = "visits"
#: int64 [1]; waypoints in this episode's memory. WaypointMemory -> figures.
NUM_WAYPOINTS: NestedKey = "num_waypoints"
#: float32 [1]; alpha / sqrt(visits), eq. 6; 0 in a birth. CountReward ->
#: IntrinsicReward.
COUNT_REWARD: NestedKey = "count_reward"
#: float32 [1]; beta / similarity in a birth, else 0, eq. 7. TemporalDistanceReward
#: -> IntrinsicReward.
TEMPORAL_DISTANCE_REWARD: NestedKey = "temporal_distance_reward"
#: float32 [1]; what the explorer learns from, eq. 8. IntrinsicReward -> losses.
INTRINSIC_REWARD: NestedKey = "intrinsic_reward"
#: float32 [1]; the reward over the deviation of its discounted return. ReturnScale ->
#: losses.
SCALED_REWARD: NestedKey = "scaled_reward"
#: bool [1]; a birth with an old waypoint near it that looks the same way.
#: WaypointTruth -> diagnostics.
FALSE_BIRTH: NestedKey = (PRIVILEGED, "false_birth")

# --- exploration: the policy ------------------------------------------------
#: uint8 [84, 84, 3]; the policy's copy of the view. PolicyPixels -> ActorCritic.
POLICY_PIXELS: NestedKey = "policy_pixels"
#: int64 [1]; the action before, 6 (none of the six) at an episode's start.
#: PreviousAction -> ActorCritic.
PREVIOUS_ACTION: NestedKey = "previous_action"
#: float32 [1]; the intrinsic reward of the decision before, clipped, 0 at an
#: episode's start. PreviousReward -> ActorCritic.
PREVIOUS_REWARD: NestedKey = "previous_reward"
#: float32 [256]; hidden and cell state of the LSTM. ActorCritic -> itself.
HIDDEN: NestedKey = ("recurrent_state", "hidden")
MEMORY_CELL: NestedKey = ("recurrent_state", "memory_cell")
#: bool [1]; the first decision of an episode. TorchRL's InitTracker -> ActorCritic.
IS_INIT: NestedKey = "is_init"
#: float32 []; log-probability of the action taken. ActorCritic -> losses.
ACTION_LOG_PROB: NestedKey = "action_log_prob"
#: float32 [1]; the critic's estimate. ActorCritic -> losses.
STATE_VALUE: NestedKey = "state_value"
#: float32 [1]; how much better the action was than the critic thought, and what the
#: critic should have said; TorchRL's keys. RecurrentPPOLoss -> itself.
ADVANTAGE: NestedKey = "advantage"
VALUE_TARGET: NestedKey = "value_target"
#: int64 [1]; number of the environment over all workers. Env factory -> learner.
ENV_ID: NestedKey = "env_id"
#: int64 [1]; versions of the policy's and of the networks' weights that made this
#: decision. Mailbox collector -> learner.
POLICY_VERSION: NestedKey = ("version", "policy")
NETWORKS_VERSION: NestedKey = ("version", "networks")

# --- navigation (graph/navigator.py) ----------------------------------------
#: uint8 [V, H, W, 3]; the goal as it was seen while exploring, the same in all
#: decisions of an episode. GoalViews -> Navigator.
GOAL_VIEWS: NestedKey = "goal_views"
#: Nested key of what the navigator decided: no truth in it, and nobody acts on it.
NAVIGATION: str = "navigation"
#: int64 [1]; waypoint where the agent believes to be, -1 if lost. Navigator ->
#: evaluation, as all that follow.
PLACE: NestedKey = (NAVIGATION, "place")
#: int64 [1]; waypoint that it walks to; -1 if lost, or at the goal's own waypoint,
#: where it walks to the goal view.
TARGET: NestedKey = (NAVIGATION, "target")
#: int64 [1]; goal waypoint at the end of the path, -1 without a path.
GOAL_NODE: NestedKey = (NAVIGATION, "goal_node")
#: float32 [1]; cost of the path that is left, infinite without one.
PATH_COST: NestedKey = (NAVIGATION, "path_cost")
#: int64 [1]; times that it closed edges and has not opened them again.
NUM_CUTS: NestedKey = (NAVIGATION, "num_cuts")
#: int64 [1]; the ends of what it closed in this decision, -1 if nothing.
CUT_FROM: NestedKey = (NAVIGATION, "cut_from")
CUT_TO: NestedKey = (NAVIGATION, "cut_to")
#: bool [1]; it does not know where it is, or no way leads on: it acts at random.
LOST: NestedKey = (NAVIGATION, "lost")
