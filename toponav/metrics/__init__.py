"""Numbers from trajectories: functions of tensordicts and arrays."""

from toponav.metrics.episode_trace import (
    EpisodeTrace as EpisodeTrace,
    effective_cells as effective_cells,
    occupancy as occupancy,
    trace_episode as trace_episode,
)
from toponav.metrics.l_report import (
    LReport as LReport,
    bayes_bound as bayes_bound,
    l_report as l_report,
    useful_actions as useful_actions,
)
from toponav.metrics.map_quality import (
    FALSE_EDGE_CELLS as FALSE_EDGE_CELLS,
    covered_cells as covered_cells,
    edge_lengths as edge_lengths,
    map_parts as map_parts,
    map_quality as map_quality,
    waypoint_shares as waypoint_shares,
)
from toponav.metrics.navigation_metrics import (
    TRACE_KEYS as TRACE_KEYS,
    TRACE_NEXT_KEYS as TRACE_NEXT_KEYS,
    NavigationTrace as NavigationTrace,
    classify_decisions as classify_decisions,
    detection_delays as detection_delays,
    find_legs as find_legs,
    first_goal as first_goal,
    judge_cuts as judge_cuts,
    mean_detour as mean_detour,
    measure_legs as measure_legs,
    slow_legs as slow_legs,
    success_weighted_by_length as success_weighted_by_length,
    success_within as success_within,
    trace_navigation as trace_navigation,
)
from toponav.metrics.score_tables import (
    aligned_table as aligned_table,
    csv_table as csv_table,
    intervals_note as intervals_note,
    markdown_table as markdown_table,
)
from toponav.metrics.statistics import (
    AtMost as AtMost,
    Estimate as Estimate,
    Floats as Floats,
    Scores as Scores,
    bootstrap as bootstrap,
    correlation as correlation,
    decisions_to_reach as decisions_to_reach,
    drop_unknown as drop_unknown,
    running_mean as running_mean,
    summarize_scores as summarize_scores,
    top_mean as top_mean,
)
from toponav.metrics.tc_report import (
    DISTANCE_CELLS as DISTANCE_CELLS,
    HEADINGS as HEADINGS,
    TCReport as TCReport,
    most_similar as most_similar,
    pose_bound as pose_bound,
    pose_features as pose_features,
    tc_report as tc_report,
)
