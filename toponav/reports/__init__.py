"""Tables and pictures of runs."""

from toponav.reports.baselines import (
    Baselines as Baselines,
    baselines_file as baselines_file,
    start_baselines as start_baselines,
)
from toponav.reports.evaluation_beside import evaluating as evaluating
from toponav.reports.experiment_figures import (
    experiment_accuracies as experiment_accuracies,
    experiment_curves as experiment_curves,
)
from toponav.reports.experiment_report import (
    Group as Group,
    explore_table as explore_table,
    pretrain_table as pretrain_table,
    require_columns as require_columns,
)
from toponav.reports.experiment_text import (
    experiment_csv as experiment_csv,
    experiment_markdown as experiment_markdown,
)
from toponav.reports.experts import (
    SCRIPTED as SCRIPTED,
    scripted_rows as scripted_rows,
)
from toponav.reports.exploration_evaluation import (
    evaluate_policies as evaluate_policies,
    summarize_evaluation as summarize_evaluation,
    write_episode_video as write_episode_video,
    write_evaluation as write_evaluation,
)
from toponav.reports.exploration_measures import (
    judged_score as judged_score,
    kept_return as kept_return,
)
from toponav.reports.exploration_report import (
    ExplorationReport as ExplorationReport,
    Timer as Timer,
)
from toponav.reports.large_mazes import large_maze_hints as large_maze_hints
from toponav.reports.map_report import report_maps as report_maps
from toponav.reports.navigation_episodes import play_policies as play_policies
from toponav.reports.navigation_report import (
    episode_table as episode_table,
    markdown_summary as markdown_summary,
    summary_row as summary_row,
    write_goals as write_goals,
    write_path as write_path,
    write_success as write_success,
    write_walk as write_walk,
)
from toponav.reports.navigation_tables import (
    navigate_table as navigate_table,
    navigation_curves as navigation_curves,
)
from toponav.reports.picture_walks import write_picture_walks as write_picture_walks
from toponav.reports.pooled_rows import (
    best_sentences as best_sentences,
)
from toponav.reports.practice_report import write_practice as write_practice
from toponav.reports.pretraining_report import (
    progress_figures as progress_figures,
    summarize as summarize,
    write_measurements as write_measurements,
    write_reports as write_reports,
)
from toponav.reports.schedule import (
    EVALUATE as EVALUATE,
    EXPLORE as EXPLORE,
    PRETRAIN as PRETRAIN,
    Schedule as Schedule,
    explore_schedule as explore_schedule,
    is_waited_for as is_waited_for,
    pretrain_schedule as pretrain_schedule,
    pretrained_share as pretrained_share,
)
from toponav.reports.sweep_report import (
    report_exploration as report_exploration,
    report_navigation as report_navigation,
    report_pretraining as report_pretraining,
)
from toponav.reports.walk_map import write_walk_map as write_walk_map
