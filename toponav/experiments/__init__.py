"""Experiments as data: which runs a table needs, where they are, how they are made."""

from toponav.experiments.cells import (
    Cell as Cell,
    plan_cells as plan_cells,
    untested_sentences as untested_sentences,
)
from toponav.experiments.choosing import (
    Choice as Choice,
    choice_sentences as choice_sentences,
    choose as choose,
    plan_tries as plan_tries,
    undrawn_sentences as undrawn_sentences,
    with_choices as with_choices,
)
from toponav.experiments.estimates import (
    announce as announce,
    expected_seconds as expected_seconds,
    missing_cells as missing_cells,
    to_make as to_make,
)
from toponav.experiments.groups import (
    make_groups as make_groups,
    missing_sentences as missing_sentences,
    scripted_of as scripted_of,
)
from toponav.experiments.kept_runs import keep_runs as keep_runs
from toponav.experiments.making import RunMaker as RunMaker
