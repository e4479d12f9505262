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
from toponav.evaluation.l_report import LReport, bayes_bound, l_report, useful_actions
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
from toponav.evaluation.waypoint_share import (
    Waypoints,
    prepare_walks,
    share_curve,
    similarity_matrix,
    waypoint_mask,
    waypoint_share,
)

__all__ = [
    "UNREACHABLE",
    "Action",
    "Binned",
    "Calibration",
    "Curve",
    "EpisodeTrace",
    "Estimate",
    "FrontierExpert",
    "LReport",
    "MazeMetric",
    "Motion",
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
    "Waypoints",
    "balanced_accuracy",
    "bayes_bound",
    "bootstrap",
    "calibrate_reach",
    "calibrate_reward_threshold",
    "calibrate_tc_threshold",
    "contact_sheet",
    "correlation",
    "csv_table",
    "decisions_to_reach",
    "draw_accuracies",
    "draw_agent",
    "draw_curves",
    "draw_exploration",
    "draw_learning_curves",
    "draw_plan",
    "draw_report",
    "draw_training",
    "draw_trajectory",
    "effective_cells",
    "expected_calibration_error",
    "explored_frames",
    "first_visits",
    "interquartile_mean",
    "l_report",
    "markdown_table",
    "mean",
    "most_similar",
    "occupancy",
    "pair_candidates",
    "pair_truth",
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
    "spread_out",
    "summarize_scores",
    "tc_report",
    "thousands",
    "top_mean",
    "trace_episode",
    "useful_actions",
    "waypoint_mask",
    "waypoint_share",
    "write_video",
]
