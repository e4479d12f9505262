"""Every tensordict key of the package: dtype, shape, unit, who writes and reads it.

Shapes leave out the batch dimensions. H and W are height and width of the world's
views, A is its number of actions, D the length of an embedding. A *decision* is one
agent step. TorchRL's own keys are listed with the meaning that TorchRL gives them.

Entries under ``PRIVILEGED`` are ground truth. Evaluation reads them; an agent never
does. A world without ground truth does not have them.
"""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torch import Tensor

# --- the environment -------------------------------------------------------
#: uint8 [H, W, 3]; the view, RGB. Env -> AreaDownsample, PolicyPixels, Navigator.
#: NoisyTV, a part of the world, writes noise into it; nothing else is overwritten.
PIXELS: NestedKey = "pixels"
#: uint8 [H / f, W / f, 3]; the view as the networks read it, f = 2 for an encoder that
#: halves views, else 1. AreaDownsample -> WaypointMemory, frame buffers, map.
NETWORK_PIXELS: NestedKey = "network_pixels"
#: int64 []; number of the action, in [0, A). Policy -> env, L-network.
ACTION: NestedKey = "action"
#: float32 [1]; the task's reward. Env -> evaluation.
REWARD: NestedKey = "reward"
#: bool [1]; ``terminated`` or ``truncated``. Env -> collectors.
DONE: NestedKey = "done"
#: bool [1]; the task ended the episode: never so in the mazes. Env -> losses.
TERMINATED: NestedKey = "terminated"
#: bool [1]; the time limit ended the episode, or its engine was lost. Env -> losses.
TRUNCATED: NestedKey = "truncated"
#: float32 [H', W']; planar depth in map units. Env -> losses of Nav A3C + D2L alone.
DEPTH: NestedKey = "depth"
#: float32 [6]; per decision: forward, left, up in map units, yaw, pitch, roll in
#: degrees. Env -> NavActorCritic.
VELOCITY: NestedKey = "velocity"

# --- ground truth, for evaluation only -------------------------------------
#: The nested key under which all privileged entries live.
PRIVILEGED: str = "privileged"
#: float32 [2]; x (east) and y (north) in map units.
POSITION: NestedKey = (PRIVILEGED, "position")
#: float32 [1]; degrees in [0, 360), 0 is east, counter-clockwise.
HEADING: NestedKey = (PRIVILEGED, "heading")
#: int64 [2]; row and column of the layout's cell in which the agent stands.
CELL: NestedKey = (PRIVILEGED, "cell")
#: int64 [2]; row and column of the goal, (-1, -1) without one.
GOAL_CELL: NestedKey = (PRIVILEGED, "goal_cell")
#: bool [S]; which of the layout's S slots are closed, in the layout's order.
BLOCKED: NestedKey = (PRIVILEGED, "blocked")
#: bool [1]; the agent reached the goal in this decision and was moved elsewhere.
RESPAWNED: NestedKey = (PRIVILEGED, "respawned")
#: float32 [1]; share of the open cells visited in this episode. Coverage -> evaluation.
COVERAGE: NestedKey = (PRIVILEGED, "coverage")
#: float32 [1]; cells entered for the first time in this decision. Coverage -> learners.
COVERAGE_REWARD: NestedKey = (PRIVILEGED, "coverage_reward")
#: int64 [L]; decisions to each of L levels, -1 if not yet. Coverage -> evaluation.
DECISIONS_TO_COVERAGE: NestedKey = (PRIVILEGED, "decisions_to_coverage")
#: int64 [1]; the waypoint of a navigator's map that is nearest in truth, -1 on an empty
#: one. TruePlace -> a Navigator that is told its place, for diagnosis.
TRUE_PLACE: NestedKey = (PRIVILEGED, "true_place")
#: bool [1]; the agent is where it was in this episode before it was elsewhere.
#: LoopClosure -> losses of Nav A3C + D2L alone.
LOOP_CLOSED: NestedKey = (PRIVILEGED, "loop_closed")
#: int64 [1]; squares of the floor entered in this episode. PlacesVisited -> evaluation.
PLACES: NestedKey = (PRIVILEGED, "places")
#: bool [1]; a new one beside one that looks the same way. WaypointTruth -> figures.
SPURIOUS_WAYPOINT: NestedKey = (PRIVILEGED, "spurious_waypoint")

# --- TC-network and L-network ----------------------------------------------
#: float32 [D]; embedding of one view. Encoders -> comparators, policy, map.
EMBEDDING: NestedKey = "embedding"
#: As NETWORK_PIXELS; earlier and later view of a training pair. SplitPairs -> losses.
ANCHOR: NestedKey = "anchor"
OTHER: NestedKey = "other"
#: float32 []; 1 for at most k decisions apart, 0 for at least M * k. Pairs -> TCLoss.
LABEL: NestedKey = "label"
#: float32 []; weight of a pair in its loss. Pair mining -> losses.
WEIGHT: NestedKey = "weight"
#: int64 []; number of the episode within a batch. Chunks -> pair mining.
EPISODE: NestedKey = "episode"
#: int64 []; number of the decision within its episode. Chunks -> pair mining.
STEP: NestedKey = "step"
#: int64 []; number of the episode, unique over workers. Collectors -> pair sampling.
TRAJECTORY: NestedKey = ("collector", "traj_ids")
#: float32 []; logit of "at most k decisions apart". TC-network -> TCLoss.
LOGIT: NestedKey = "logit"
#: float32 [A]; of the actions. L-network -> LLoss, Navigator; ActorCritic -> losses.
LOGITS: NestedKey = "logits"

# --- exploration: intrinsic rewards -----------------------------------------
#: int64 [1]; the view's waypoint, itself if it is new, -1 for none. WaypointMemory ->
#: figures.
WAYPOINT: NestedKey = "waypoint"
#: float32 [1]; in [0, 1], to the nearest waypoint that was there before.
#: WaypointMemory -> TemporalDistanceReward.
SIMILARITY: NestedKey = "similarity"
#: bool [1]; the view is similar to no waypoint; it may become one. WaypointMemory ->
#: figures.
NOVEL: NestedKey = "novel"
#: bool [1]; the view became a waypoint in this decision. WaypointMemory -> rewards.
IS_NEW_WAYPOINT: NestedKey = "is_new_waypoint"
#: int64 [1]; of the view's waypoint, with this one, 0 if the decision is no visit.
#: WaypointMemory -> CountReward.
VISITS: NestedKey = "visits"
#: int64 [1]; number of waypoints of this episode. WaypointMemory -> figures.
NUM_WAYPOINTS: NestedKey = "num_waypoints"
#: float32 [1]; alpha / sqrt(visits), 0 for a new one, eq. 6. CountReward -> the sum.
COUNT_REWARD: NestedKey = "count_reward"
#: float32 [1]; beta / similarity of a new one, else 0, eq. 7. Its transform -> the sum.
TEMPORAL_DISTANCE_REWARD: NestedKey = "temporal_distance_reward"
#: float32 [1]; what the reward method pays. IntrinsicReward (the sum of both, eq. 8),
#: RandomReward, RNDTransform, CuriosityReward, InformationGainReward,
#: ExemplarReward -> learners.
INTRINSIC_REWARD: NestedKey = "intrinsic_reward"
#: uint8 [H', W', K]; the last K views, small and grey, the newest last. GreyStack ->
#: CuriosityReward, InformationGainReward, ICM, VIME.
FRAME_STACK: NestedKey = "frame_stack"
#: uint8 [H', W', 3]; the view as EX2 reads it. PolicyPixels -> ExemplarReward, EX2.
SMALL_PIXELS: NestedKey = "small_pixels"
#: float32 [1]; the reward over the deviation of its return. ReturnScale -> losses.
SCALED_REWARD: NestedKey = "scaled_reward"

# --- exploration: the policy ------------------------------------------------
#: uint8 [H', W', 3]; the view at the policy's size. PolicyPixels -> ActorCritic.
POLICY_PIXELS: NestedKey = "policy_pixels"
#: int64 [1]; the last action, A at an episode's start. PreviousAction -> ActorCritic.
PREVIOUS_ACTION: NestedKey = "previous_action"
#: float32 [1]; the last reward, clipped, 0 at an episode's start. PreviousReward ->
#: ActorCritic, Navigator.
PREVIOUS_REWARD: NestedKey = "previous_reward"
#: float32 [C], of DRQN [1, C]; hidden and cell state of the LSTM. ActorCritic and DRQN
#: -> themselves.
HIDDEN: NestedKey = ("recurrent_state", "hidden")
MEMORY_CELL: NestedKey = ("recurrent_state", "memory_cell")
#: uint8 [H', W', 3 (K - 1)]; the views before this one, the oldest first, black before
#: an episode's start. DQN's policy -> itself.
FRAMES: NestedKey = ("recurrent_state", "frames")
#: float32 [A]; of the actions: discounted reward, scaled. DQN, DRQN -> their losses.
ACTION_VALUE: NestedKey = "action_value"
#: bool [1]; the first decision of an episode. TorchRL's InitTracker -> ActorCritic.
IS_INIT: NestedKey = "is_init"
#: float32 []; log-probability of the action. ActorCritic -> losses.
ACTION_LOG_PROB: NestedKey = "action_log_prob"
#: float32 [1]; the critic's estimate of the return. ActorCritic -> losses.
STATE_VALUE: NestedKey = "state_value"
#: float32 [1]; of the action, and the critic's target. Value estimators -> losses.
ADVANTAGE: NestedKey = "advantage"
VALUE_TARGET: NestedKey = "value_target"
#: int64 [1]; number of the env over all workers. MailboxCollector -> learners, map.
ENV_ID: NestedKey = "env_id"
#: int64 [1]; of the networks that judged this decision. MailboxCollector -> map, log.
#: It writes ("version", name) of all weights that it fetches.
NETWORKS_VERSION: NestedKey = ("version", "networks")

# --- navigation (graph/navigation) ------------------------------------------
#: uint8 [V, H, W, 3]; of the goal, the same in all decisions. GoalViews -> Navigator.
GOAL_VIEWS: NestedKey = "goal_views"
#: Nested key of the navigator's state, for evaluation: no policy reads it.
NAVIGATION: str = "navigation"
#: int64 [1]; waypoint at which the navigator localises the agent, -1 if lost.
PLACE: NestedKey = (NAVIGATION, "place")
#: int64 [1]; next waypoint of the plan; -1 if lost, or once at the goal's waypoint.
TARGET: NestedKey = (NAVIGATION, "target")
#: int64 [1]; goal waypoint at the end of the path, -1 without a path.
GOAL_NODE: NestedKey = (NAVIGATION, "goal_node")
#: float32 [1]; cost of the rest of the path, infinite without one.
PATH_COST: NestedKey = (NAVIGATION, "path_cost")
#: int64 [1]; how often edges were cut and not yet restored.
NUM_CUTS: NestedKey = (NAVIGATION, "num_cuts")
#: int64 [1]; both ends of the edges cut in this decision, -1 for none.
CUT_FROM: NestedKey = (NAVIGATION, "cut_from")
CUT_TO: NestedKey = (NAVIGATION, "cut_to")
#: bool [1]; the agent is not localised, or no path leads on: actions are random.
LOST: NestedKey = (NAVIGATION, "lost")

#: float32 [S]; what it senses beside its view. PractisingNavigator -> SteeringNetwork.
SENSES: NestedKey = (NAVIGATION, "senses")
#: float32 [A]; decisions that are left after each action in free space, negative.
FREE_LOGITS: NestedKey = (NAVIGATION, "free_logits")
#: float32 [1]; decisions fewer that are left than before. It -> SteeringPractice.
PROGRESS: NestedKey = (NAVIGATION, "progress")
#: bool [1]; it believes to be at its target, or gives it up, and has a new one.
REACHED: NestedKey = (NAVIGATION, "reached")
GAVE_UP: NestedKey = (NAVIGATION, "gave_up")

# --- reading them -----------------------------------------------------------
_MEMORY = "WaypointMemory"
_PRIMER = "the policy's make_tensordict_primer()"
_CHUNKS = "a replay buffer with EpisodeSampler(Chunks())"
_PAIRS = "pairs of MinedPairs or DrawnPairs"
_TRUTH = "MazeEnv(privileged=True)"
_REWARD = "IntrinsicReward, or name the task's reward by in_keys=['reward']"
#: What writes an entry, where that helps who lacks it.
WRITERS: dict[NestedKey, str] = {
    PIXELS: "views (GymEnv has some with from_pixels=True)",
    NETWORK_PIXELS: "AreaDownsample",
    POLICY_PIXELS: "PolicyPixels",
    EMBEDDING: "WaypointMemory or EmbedViews",
    ANCHOR: _PAIRS,
    OTHER: _PAIRS,
    PREVIOUS_ACTION: "PreviousAction",
    PREVIOUS_REWARD: "PreviousReward",
    COUNT_REWARD: "CountReward",
    TEMPORAL_DISTANCE_REWARD: "TemporalDistanceReward",
    INTRINSIC_REWARD: _REWARD,
    FRAME_STACK: "GreyStack",
    GOAL_VIEWS: "GoalViews",
    LOOP_CLOSED: "LoopClosure",
    ENV_ID: "the numbers of the envs, [E, T, 1]",
    DEPTH: "MazeEnv(depth=...)",
    VELOCITY: "MazeEnv(velocity=True)",
    IS_INIT: "TorchRL's InitTracker",
    HIDDEN: _PRIMER,
    MEMORY_CELL: _PRIMER,
    FRAMES: _PRIMER,
    WAYPOINT: _MEMORY,
    VISITS: _MEMORY,
    SIMILARITY: _MEMORY,
    IS_NEW_WAYPOINT: _MEMORY,
    EPISODE: _CHUNKS,
    STEP: _CHUNKS,
    POSITION: _TRUTH,
    HEADING: _TRUTH,
    CELL: _TRUTH,
    GOAL_CELL: _TRUTH,
    BLOCKED: _TRUTH,
}


def read_entry(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """An entry that is needed.

    Raises:
        KeyError: if it is missing; the sentence names what writes it, if that is known.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> read_entry(TensorDict(action=torch.tensor(2)), "action")
        tensor(2)
    """
    entry: Tensor | None = tensordict.get(key, None)
    if entry is None:
        names = sorted(str(name) for name in tensordict.keys(True, True))
        found = ", ".join(names) or "none"
        hint = f": add {WRITERS[key]}" if key in WRITERS else ""
        raise KeyError(f"the tensordict must have {key!r}{hint}, got {found}")
    return entry


def select_entries(
    tensordict: TensorDictBase, wanted: Sequence[NestedKey]
) -> TensorDictBase:
    """The entries that are needed, alone; KeyError as of `read_entry`."""
    for key in wanted:
        read_entry(tensordict, key)
    return tensordict.select(*wanted)
