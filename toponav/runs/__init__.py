"""Run folders: locks, checkpoints, tables, drawn settings."""

from toponav.runs.checkpoint_files import (
    CHECKPOINT_FILE as CHECKPOINT_FILE,
    reading_checkpoint as reading_checkpoint,
    reason_of as reason_of,
    save_atomically as save_atomically,
)
from toponav.runs.draws import (
    DRAWS_FILE as DRAWS_FILE,
    keep_draws as keep_draws,
    log_uniform as log_uniform,
)
from toponav.runs.files import (
    Figures as Figures,
    alone_with as alone_with,
    make_loggers as make_loggers,
    remove_halves as remove_halves,
    remove_halves_of as remove_halves_of,
    replacing as replacing,
    write_array as write_array,
    write_history as write_history,
    write_text as write_text,
)
from toponav.runs.idle import IdleWatch as IdleWatch
from toponav.runs.locks import (
    CONTINUES as CONTINUES,
    StoppedError as StoppedError,
    alone_in as alone_in,
    is_at as is_at,
    locked as locked,
    remove_empty as remove_empty,
    remove_unused as remove_unused,
    stop_requests as stop_requests,
)
from toponav.runs.room import (
    require_memory as require_memory,
    require_room as require_room,
    require_shared_memory as require_shared_memory,
)
from toponav.runs.run_folders import (
    LAYOUT_FILE as LAYOUT_FILE,
    BrokenRunError as BrokenRunError,
    Exploration as Exploration,
    Run as Run,
    find_runs as find_runs,
    folders_of_runs as folders_of_runs,
    group_runs as group_runs,
    has_results as has_results,
    read_exploration as read_exploration,
    read_navigation as read_navigation,
    read_pretraining as read_pretraining,
    read_table as read_table,
    swept_settings as swept_settings,
)
from toponav.runs.weights import (
    load_weights as load_weights,
    read_counts as read_counts,
    require_like as require_like,
    require_plain as require_plain,
)
