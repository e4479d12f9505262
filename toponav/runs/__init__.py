"""What a run leaves on disk: folders, checkpoints, tables."""

from toponav.runs.atomic import replacing as replacing
from toponav.runs.checkpoints import (
    CHECKPOINT_FILE as CHECKPOINT_FILE,
    load_checkpoint as load_checkpoint,
    save_atomically as save_atomically,
)
from toponav.runs.run_files import (
    Figures as Figures,
    make_loggers as make_loggers,
    write_array as write_array,
    write_history as write_history,
    write_text as write_text,
)
from toponav.runs.run_folders import (
    BrokenRunError as BrokenRunError,
    Exploration as Exploration,
    Run as Run,
    find_runs as find_runs,
    group_runs as group_runs,
    read_exploration as read_exploration,
    read_pretraining as read_pretraining,
    read_table as read_table,
    swept_settings as swept_settings,
)
from toponav.runs.stop_requests import stop_requests as stop_requests
