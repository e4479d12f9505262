"""Numbers from trajectories: functions of tensordicts and arrays."""

from toponav.metrics.diagnostics import (
    effective_cells as effective_cells,
    occupancy as occupancy,
)
from toponav.metrics.episode_trace import (
    EpisodeTrace as EpisodeTrace,
    trace_episode as trace_episode,
)
from toponav.metrics.l_report import (
    LReport as LReport,
    bayes_bound as bayes_bound,
    l_report as l_report,
    useful_actions as useful_actions,
)
from toponav.metrics.map_quality import (
    MapQuality as MapQuality,
    covered_cells as covered_cells,
    edge_lengths as edge_lengths,
    map_quality as map_quality,
)
from toponav.metrics.navigation_faults import (
    FAULTS as FAULTS,
    Cut as Cut,
    classify_decisions as classify_decisions,
    detection_delays as detection_delays,
    judge_cuts as judge_cuts,
    slow_legs as slow_legs,
)
from toponav.metrics.navigation_metrics import (
    LegMeasures as LegMeasures,
    first_goal as first_goal,
    goals_reached as goals_reached,
    mean_detour as mean_detour,
    measure_legs as measure_legs,
    success_weighted_by_length as success_weighted_by_length,
    success_within as success_within,
)
from toponav.metrics.navigation_trace import (
    TRACE_KEYS as TRACE_KEYS,
    TRACE_NAVIGATION_KEYS as TRACE_NAVIGATION_KEYS,
    TRACE_NEXT_KEYS as TRACE_NEXT_KEYS,
    Leg as Leg,
    NavigationTrace as NavigationTrace,
    find_legs as find_legs,
    trace_navigation as trace_navigation,
)
from toponav.metrics.place_error import (
    most_similar as most_similar,
    pair_candidates as pair_candidates,
    place_error as place_error,
)
from toponav.metrics.pose_bound import (
    pose_bound as pose_bound,
    pose_features as pose_features,
)
from toponav.metrics.statistics import (
    Estimate as Estimate,
    Floats as Floats,
    Ints as Ints,
    bootstrap as bootstrap,
    correlation as correlation,
    running_mean as running_mean,
    top_mean as top_mean,
)
from toponav.metrics.sweep_tables import (
    Scores as Scores,
    Summary as Summary,
    aligned_table as aligned_table,
    csv_table as csv_table,
    decisions_to_reach as decisions_to_reach,
    markdown_table as markdown_table,
    summarize_scores as summarize_scores,
)
from toponav.metrics.tc_report import (
    DISTANCE_CELLS as DISTANCE_CELLS,
    HEADINGS as HEADINGS,
    TCReport as TCReport,
    tc_report as tc_report,
)
