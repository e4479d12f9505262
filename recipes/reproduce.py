"""Make a table of the paper and its figure by one command.

    python recipes/reproduce.py experiment=table3
    python recipes/reproduce.py experiment=table7 seeds=3
    python recipes/reproduce.py experiment=fig14 make=false
    python recipes/reproduce.py -m experiment=table3,table7
    python recipes/reproduce.py -m worker=0,1,2,3 hydra/launcher=submitit_slurm

``conf/experiment`` says which methods, mazes and columns a table has. Runs with the
settings that it needs are looked for in ``runs``, whoever made them; those that are
missing are made by the other recipes, and those that were cut off go on. Started again
after a kill, it goes on too; started twice, both share the work. ``folder`` gets
``<experiment>.csv``, ``.md`` and ``.png``: means and interquartile means with 95 %
bootstrap intervals, and the paper's own figures beside them. ``runs`` in it keeps the
tables of each finished run, which are enough to make all that again. A run that fails
ends nothing: it is named at the end and missing in the table.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

import sys
import tempfile
from pathlib import Path

from toponav import experiments, reports
from toponav.builders import prepare_process
from toponav.config import ReproduceConfig, TrainingError
from toponav.launch import recipe
from toponav.plotting import save_figure
from toponav.runs import alone_with, write_text

RECIPES = Path(__file__).parent


@recipe("reproduce", aliases={"scale": "reproduce"})
def main(settings: ReproduceConfig, _: Path) -> None:
    """Find the runs, make those that are missing, write the table and the figure."""
    prepare_process(threads=1)
    experiment, folder = settings.experiment, Path(settings.folder)
    untested = experiments.untested_sentences(settings)
    reports.require_columns(experiment)

    # Which runs it takes, and how long those that are missing will. Settings that are
    # drawn by chance are tried in other mazes before, and the best ones taken.
    tries = experiments.plan_tries(settings)
    cells = experiments.plan_cells(settings)
    said = experiments.announce(settings, [*tries, *cells])
    print(*untested, said, sep="\n", file=sys.stderr, flush=True)
    for needed in (folder, Path(settings.runs)):
        needed.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=needed).close()
    path = folder / experiment.name

    # Policies that do not learn come first: later runs find their episodes.
    scripted = experiments.scripted_of(settings, cells, play=settings.make)

    # The runs, each in a process of its own recipe. Their tables are kept beside ours.
    experiments.keep_runs([*tries, *cells])
    maker = experiments.RunMaker(RECIPES, jobs=settings.jobs, poll_s=settings.poll_s)
    chosen = experiments.undrawn_sentences(settings)
    if tries:
        if settings.make:
            maker.make(*experiments.to_make(settings, tries))
        choices = experiments.choose(settings, tries)
        chosen = experiments.choice_sentences(settings, choices)
        settings = experiments.with_choices(settings, choices)
        cells = experiments.plan_cells(settings)
        print(experiments.announce(settings, cells), file=sys.stderr, flush=True)
    if settings.make:
        maker.make(*experiments.to_make(settings, cells))

    # The table and the figure of what there is.
    experiments.keep_runs(cells)
    groups = experiments.make_groups(settings, cells)
    if experiment.recipe == "explore":
        table = reports.explore_table(groups, scripted, draws=settings.draws)
        figure = reports.experiment_curves(groups, scripted, title=experiment.title)
    elif experiment.recipe == "navigate":
        table = reports.navigate_table(groups, draws=settings.draws)
        figure = reports.navigation_curves(groups, title=experiment.title)
    else:
        table = reports.pretrain_table(groups, draws=settings.draws)
        figure = reports.experiment_accuracies(groups, title=experiment.title)
    missing = experiments.missing_sentences([*tries, *cells], maker.failures)
    markdown = reports.experiment_markdown(table, experiment.columns)
    best = reports.best_sentences(settings.experiment.rows, table)
    below = "".join(
        f"- {sentence}\n"
        for sentence in (*best, *experiment.remarks, *untested, *chosen, *missing)
    )
    heading = f"# {experiment.title}\n\n"
    text = f"{heading}{markdown}\n{below}".rstrip()
    made = [Path(f"{path}.{kind}") for kind in ("md", "csv", "png")]
    with alone_with(*made):
        write_text(made[0], f"{text}\n")
        write_text(made[1], reports.experiment_csv(table))
        save_figure(figure, made[2])
    print(f"{markdown}\nwritten to {path}.md, .csv and .png")
    for sentence in missing:
        print(sentence, file=sys.stderr)
    if maker.failures:
        rule = "all runs of an experiment must end well"
        raise TrainingError(f"{rule}, got {len(maker.failures)} that failed")


if __name__ == "__main__":
    main()
