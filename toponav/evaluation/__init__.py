"""Scripted policies, metrics and figures: functions of tensordicts and arrays."""

from toponav.evaluation.calibration import (
    Calibration,
    calibrate_reach,
    calibrate_reward_threshold,
    calibrate_tc_threshold,
)
from toponav.evaluation.classification import (
    Binned,
    balanced_accuracy,
    expected_calibration_error,
    roc_auc,
    roc_curve,
)
from toponav.evaluation.contact_sheet import contact_sheet, spread_out
from toponav.evaluation.curves import draw_curves
from toponav.evaluation.diagnostics import (
    correlation,
    effective_cells,
    first_visits,
    occupancy,
    reward_by_new_cells,
)
from toponav.evaluation.episode_trace import EpisodeTrace, trace_episode
from toponav.evaluation.episode_video import explored_frames
from toponav.evaluation.experts import FrontierExpert, PathFollower
from toponav.evaluation.exploration_curves import draw_training
from toponav.evaluation.exploration_map import draw_exploration
from toponav.evaluation.goal_places import pick_goal_views
from toponav.evaluation.l_report import LReport, bayes_bound, l_report, useful_actions
from toponav.evaluation.map_figure import draw_topological_map
from toponav.evaluation.map_quality import (
    MapQuality,
    covered_cells,
    edge_lengths,
    map_quality,
)
from toponav.evaluation.navigation_faults import (
    FAULTS,
    Cut,
    classify_decisions,
    detection_delays,
    judge_cuts,
    slow_legs,
)
from toponav.evaluation.navigation_figures import draw_leg, draw_success
from toponav.evaluation.navigation_metrics import (
    LegMeasures,
    TrueWays,
    first_goal,
    goals_reached,
    mean_detour,
    measure_legs,
    success_weighted_by_length,
    success_within,
)
from toponav.evaluation.navigation_trace import (
    TRACE_KEYS,
    TRACE_NAVIGATION_KEYS,
    TRACE_NEXT_KEYS,
    Leg,
    NavigationTrace,
    find_legs,
    trace_navigation,
)
from toponav.evaluation.navigation_video import navigated_frames
from toponav.evaluation.pair_truth import MazeMetric, PairTruth, pair_truth
from toponav.evaluation.plan import draw_agent, draw_plan, draw_trajectory
from toponav.evaluation.pose_bound import pose_bound, pose_features
from toponav.evaluation.random_walks import RandomPolicy, StickyPolicy
from toponav.evaluation.report_figure import ShareCurve, draw_report
from toponav.evaluation.routes import UNREACHABLE, Routes
from toponav.evaluation.statistics import (
    Estimate,
    bootstrap,
    interquartile_mean,
    mean,
    running_mean,
    top_mean,
)
from toponav.evaluation.steering import Action, Motion
from toponav.evaluation.sweep_figures import (
    Curve,
    draw_accuracies,
    draw_learning_curves,
    thousands,
)
from toponav.evaluation.sweep_tables import (
    Scores,
    Summary,
    csv_table,
    decisions_to_reach,
    markdown_table,
    summarize_scores,
)
from toponav.evaluation.tc_report import (
    TCReport,
    most_similar,
    pair_candidates,
    place_error,
    tc_report,
)
from toponav.evaluation.video import PlanRenderer, side_by_side, write_video
from toponav.evaluation.waypoint_poses import WaypointPoses
from toponav.evaluation.waypoint_share import (
    Waypoints,
    prepare_walks,
    share_curve,
    similarity_matrix,
    waypoint_mask,
    waypoint_share,
)

__all__ = [
    "FAULTS",
    "TRACE_KEYS",
    "TRACE_NAVIGATION_KEYS",
    "TRACE_NEXT_KEYS",
    "UNREACHABLE",
    "Action",
    "Binned",
    "Calibration",
    "Curve",
    "Cut",
    "EpisodeTrace",
    "Estimate",
    "FrontierExpert",
    "LReport",
    "Leg",
    "LegMeasures",
    "MapQuality",
    "MazeMetric",
    "Motion",
    "NavigationTrace",
    "PairTruth",
    "PathFollower",
    "PlanRenderer",
    "RandomPolicy",
    "Routes",
    "Scores",
    "ShareCurve",
    "StickyPolicy",
    "Summary",
    "TCReport",
    "TrueWays",
    "WaypointPoses",
    "Waypoints",
    "balanced_accuracy",
    "bayes_bound",
    "bootstrap",
    "calibrate_reach",
    "calibrate_reward_threshold",
    "calibrate_tc_threshold",
    "classify_decisions",
    "contact_sheet",
    "correlation",
    "covered_cells",
    "csv_table",
    "decisions_to_reach",
    "detection_delays",
    "draw_accuracies",
    "draw_agent",
    "draw_curves",
    "draw_exploration",
    "draw_learning_curves",
    "draw_leg",
    "draw_plan",
    "draw_report",
    "draw_success",
    "draw_topological_map",
    "draw_training",
    "draw_trajectory",
    "edge_lengths",
    "effective_cells",
    "expected_calibration_error",
    "explored_frames",
    "find_legs",
    "first_goal",
    "first_visits",
    "goals_reached",
    "interquartile_mean",
    "judge_cuts",
    "l_report",
    "map_quality",
    "markdown_table",
    "mean",
    "mean_detour",
    "measure_legs",
    "most_similar",
    "navigated_frames",
    "occupancy",
    "pair_candidates",
    "pair_truth",
    "pick_goal_views",
    "place_error",
    "pose_bound",
    "pose_features",
    "prepare_walks",
    "reward_by_new_cells",
    "roc_auc",
    "roc_curve",
    "running_mean",
    "share_curve",
    "side_by_side",
    "similarity_matrix",
    "slow_legs",
    "spread_out",
    "success_weighted_by_length",
    "success_within",
    "summarize_scores",
    "tc_report",
    "thousands",
    "top_mean",
    "trace_episode",
    "trace_navigation",
    "useful_actions",
    "waypoint_mask",
    "waypoint_share",
    "write_video",
]
