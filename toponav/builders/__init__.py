"""The only place where settings become objects."""

from toponav.builders.collection import (
    FRAME_KEYS,
    collect_held_out,
    make_collector,
    make_frame_buffer,
    split_mazes,
)
from toponav.builders.devices import make_autocast, make_device
from toponav.builders.mazes import make_env, make_layout
from toponav.builders.networks import (
    NETWORKS_FILE,
    Networks,
    load_networks,
    make_networks,
    save_networks,
    start_networks,
)
from toponav.builders.process_memory import keep_freed_memory
from toponav.builders.report import calibrate, embed_sequences, summarize, write_reports
from toponav.builders.run_files import (
    make_loggers,
    write_measurements,
    write_text,
)
from toponav.builders.run_folders import find_runs
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

__all__ = [
    "FRAME_KEYS",
    "NETWORKS_FILE",
    "Networks",
    "Validation",
    "calibrate",
    "collect_held_out",
    "decisions_due",
    "embed_sequences",
    "embed_views",
    "find_runs",
    "keep_freed_memory",
    "learning_rate",
    "load_networks",
    "make_autocast",
    "make_collector",
    "make_device",
    "make_env",
    "make_frame_buffer",
    "make_layout",
    "make_loggers",
    "make_losses",
    "make_networks",
    "make_optimizer",
    "make_pair_source",
    "report_exploration",
    "report_pretraining",
    "require_finite",
    "restore_training",
    "save_networks",
    "save_training",
    "split_mazes",
    "start_networks",
    "summarize",
    "write_measurements",
    "write_reports",
    "write_text",
]
