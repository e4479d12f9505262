"""The only place where settings become objects."""

from toponav.builders.collection import (
    FRAME_KEYS,
    collect_frames,
    collect_held_out,
    make_frame_buffer,
    split_mazes,
)
from toponav.builders.devices import make_autocast, make_device
from toponav.builders.episode_log import EpisodeLog, Row, mean_of
from toponav.builders.exploration_evaluation import (
    Evaluation,
    evaluate_policies,
    summarize_evaluation,
    write_evaluation,
)
from toponav.builders.exploration_pictures import write_episode_video
from toponav.builders.exploration_report import ExplorationReport, Timer
from toponav.builders.exploration_state import (
    ExplorationState,
    save_exploration,
    save_policy,
    start_exploration,
)
from toponav.builders.explore_collector import (
    NETWORKS,
    POLICY,
    CollectionError,
    collect_batches,
    make_explore_collector,
    make_mailbox,
)
from toponav.builders.explore_env import make_actor_critic, make_explore_env
from toponav.builders.learner import Learner
from toponav.builders.map_growth import MapGrowth, make_map_growth
from toponav.builders.mazes import make_env, make_layout
from toponav.builders.navigation import Explored, load_explored, make_navigator
from toponav.builders.navigation_evaluation import (
    Played,
    episode_rows,
    make_policies,
    markdown_summary,
    play_policies,
    summary_row,
)
from toponav.builders.navigation_goals import (
    GoalPlaces,
    closed_letters,
    find_lost_goals,
    make_goal_places,
    make_navigation_env,
)
from toponav.builders.navigation_pictures import write_leg, write_success, write_walk
from toponav.builders.navigation_report import report_navigation
from toponav.builders.networks import (
    NETWORKS_FILE,
    Networks,
    load_networks,
    make_networks,
    save_networks,
    start_networks,
)
from toponav.builders.novelty import Novelty, make_novelty
from toponav.builders.online import make_online_learning
from toponav.builders.pretraining import prepare_networks, pretraining_decisions
from toponav.builders.process_memory import keep_freed_memory
from toponav.builders.report import calibrate, embed_sequences, summarize, write_reports
from toponav.builders.run_files import (
    make_loggers,
    write_history,
    write_measurements,
    write_text,
)
from toponav.builders.run_folders import find_runs
from toponav.builders.shutdown import stop_collector
from toponav.builders.sweep_report import report_exploration, report_pretraining
from toponav.builders.training import (
    decisions_due,
    learning_rate,
    make_losses,
    make_optimizer,
    make_pair_source,
    require_finite,
    restore_training,
    save_training,
)
from toponav.builders.validation import Validation, embed_views
from toponav.builders.walks import make_walks

__all__ = [
    "FRAME_KEYS",
    "NETWORKS",
    "NETWORKS_FILE",
    "POLICY",
    "CollectionError",
    "EpisodeLog",
    "Evaluation",
    "ExplorationReport",
    "ExplorationState",
    "Explored",
    "GoalPlaces",
    "Learner",
    "MapGrowth",
    "Networks",
    "Novelty",
    "Played",
    "Row",
    "Timer",
    "Validation",
    "calibrate",
    "closed_letters",
    "collect_batches",
    "collect_frames",
    "collect_held_out",
    "decisions_due",
    "embed_sequences",
    "embed_views",
    "episode_rows",
    "evaluate_policies",
    "find_lost_goals",
    "find_runs",
    "keep_freed_memory",
    "learning_rate",
    "load_explored",
    "load_networks",
    "make_actor_critic",
    "make_autocast",
    "make_device",
    "make_env",
    "make_explore_collector",
    "make_explore_env",
    "make_frame_buffer",
    "make_goal_places",
    "make_layout",
    "make_loggers",
    "make_losses",
    "make_mailbox",
    "make_map_growth",
    "make_navigation_env",
    "make_navigator",
    "make_networks",
    "make_novelty",
    "make_online_learning",
    "make_optimizer",
    "make_pair_source",
    "make_policies",
    "make_walks",
    "markdown_summary",
    "mean_of",
    "play_policies",
    "prepare_networks",
    "pretraining_decisions",
    "report_exploration",
    "report_navigation",
    "report_pretraining",
    "require_finite",
    "restore_training",
    "save_exploration",
    "save_networks",
    "save_policy",
    "save_training",
    "split_mazes",
    "start_exploration",
    "start_networks",
    "stop_collector",
    "summarize",
    "summarize_evaluation",
    "summary_row",
    "write_episode_video",
    "write_evaluation",
    "write_history",
    "write_leg",
    "write_measurements",
    "write_reports",
    "write_success",
    "write_text",
    "write_walk",
]
