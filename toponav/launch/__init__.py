"""From a command line to a recipe's settings, with errors of one sentence."""

from toponav.launch.arguments import (
    folder_name as folder_name,
    named_folder as named_folder,
    resumed_arguments as resumed_arguments,
)
from toponav.launch.jobs import recipe as recipe
from toponav.launch.pretraining import require_pretraining as require_pretraining
