"""Make one table and one figure of the runs of a sweep.

    python recipes/report.py multirun/explore/20260101-120000

Runs that differ in their seeds alone are one group. Of each group, the table gives mean
and interquartile mean with 95 % bootstrap intervals, and the mean of the five best,
which is how the paper reports and which flatters. Where settings were drawn by chance
(`log_uniform`), all draws are one group, and the five best stand below the table. The
folder gets ``report.md``, ``report.csv`` and a figure: learning curves of explorations,
goals that evaluations of navigation reached, accuracies of pre-trainings over the swept
setting. Where it holds runs of several recipes, there is one of each for each of them.
``maps.md`` and ``maps.csv`` say what the maps of explorations are worth.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

import sys
from pathlib import Path

from toponav.config import SettingsError, SweepReportConfig
from toponav.launch import recipe
from toponav.metrics import csv_table, markdown_table, summarize_scores
from toponav.plotting import save_figure
from toponav.reports import (
    report_exploration,
    report_maps,
    report_navigation,
    report_pretraining,
)
from toponav.runs import alone_with, find_runs, require_room, write_text

#: Room for tables and figures, in MB.
_TABLES_MB = 1.0
REPORTS = {
    "explore": report_exploration,
    "navigate": report_navigation,
    "pretrain": report_pretraining,
}


@recipe("report", first="folder", aliases={"scale": "report"})
def main(settings: SweepReportConfig, _: Path) -> None:
    """Find the runs, group them, write the table and the figure."""
    folder = Path(settings.folder)
    runs = find_runs(folder)
    require_room(folder, "folder", _TABLES_MB)
    present = [name for name in REPORTS if any(run.recipe == name for run in runs)]
    texts = []
    for name in present:
        own = [run for run in runs if run.recipe == name]
        report = REPORTS[name](own, title=f"{name}: {folder.name}")
        for sentence in report.left_out:
            print(sentence, file=sys.stderr)
        if report.figure is None:
            continue

        # One file of each kind, or one for each recipe.
        path = folder / ("report" if len(present) == 1 else f"report_{name}")
        scores = summarize_scores(
            report.scores,
            subject=report.subject,
            unit=report.unit,
            draws=settings.draws,
        )
        table = markdown_table(scores)
        best = [
            f"\n- best draw {at} of {one.subject}, {one.measure}: {mean:.1f}, {draw}"
            for one in report.scores
            for at, (mean, draw) in enumerate(one.best_draws, 1)
        ]
        below = [*best, *(f"\n- {sentence}" for sentence in report.left_out)]
        made = [Path(f"{path}.{kind}") for kind in ("md", "csv", "png")]
        with alone_with(*made):
            write_text(made[0], f"{table}{''.join(below)}".rstrip() + "\n")
            write_text(made[1], csv_table(scores))
            save_figure(report.figure, made[2])
        texts.append(f"{table}\nwritten to {path}.md, .csv and .png")

    # The maps that explorations made, where there is ground truth to judge them by.
    maps, without = report_maps([run for run in runs if run.recipe == "explore"])
    if maps:
        scores = summarize_scores(maps, subject="of", unit="runs", draws=settings.draws)
        table = markdown_table(scores)
        remarks = "".join(f"\n- {sentence}" for sentence in without)
        made = [folder / "maps.md", folder / "maps.csv"]
        with alone_with(*made):
            write_text(made[0], f"{table}{remarks}".rstrip() + "\n")
            write_text(made[1], csv_table(scores))
        texts.append(f"{table}\nwritten to {folder / 'maps'}.md and .csv")
    if not texts:
        raise SettingsError(
            f"folder must hold a finished run of {' or '.join(REPORTS)}, got none in "
            f"'{folder}'"
        )
    print("\n\n".join(texts))


if __name__ == "__main__":
    main()
