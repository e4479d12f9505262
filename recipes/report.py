"""Make one table and one figure of the runs of a sweep.

    python recipes/report.py multirun/explore/20260101-120000

Runs that differ in their seeds alone are one group. Of each group, the table gives mean
and interquartile mean with 95 % bootstrap intervals, and the mean of the five best,
which is how the paper reports and which flatters. The folder gets ``report.md``,
``report.csv`` and a figure: learning curves of explorations, goals that evaluations of
navigation reached, accuracies of pre-trainings over the swept setting. Where it holds
runs of several recipes, there is one of each for each of them.
"""

import sys
from pathlib import Path

from toponav.builders import (
    find_runs,
    report_exploration,
    report_navigation,
    report_pretraining,
    write_text,
)
from toponav.config import SettingsError, SweepReportConfig
from toponav.evaluation import csv_table, markdown_table, summarize_scores
from toponav.launch import recipe

REPORTS = {
    "explore": report_exploration,
    "navigate": report_navigation,
    "pretrain": report_pretraining,
}


@recipe("report", first="folder")
def main(settings: SweepReportConfig, _: Path) -> None:
    """Find the runs, group them, write the table and the figure."""
    folder = Path(settings.folder)
    found = find_runs(folder)
    runs = {name: [run for run in found if run.recipe == name] for name in REPORTS}
    there = [name for name, some in runs.items() if some]
    texts = []
    for name in there:
        report = REPORTS[name](runs[name], title=f"{name}: {folder.name}")
        for sentence in report.left_out:
            print(sentence, file=sys.stderr)
        if not report.figure:
            continue

        # One file of each kind, or one for each recipe.
        stem = "report" if len(there) == 1 else f"report_{name}"
        summaries = [summarize_scores(scores) for scores in report.scores]
        heads = {"subject": report.subject, "unit": report.unit}
        table = markdown_table(summaries, **heads)
        left_out = "".join(f"\n- {sentence}" for sentence in report.left_out)
        write_text(folder / f"{stem}.md", f"{table}{left_out}".rstrip() + "\n")
        write_text(folder / f"{stem}.csv", csv_table(summaries, **heads))
        report.figure.savefig(folder / f"{stem}.png", dpi=150)
        texts.append(f"{table}\nwritten to {folder / stem}.md, .csv and .png")
    if not texts:
        kinds = " or ".join(REPORTS)
        raise SettingsError(
            f"folder must hold a finished run of {kinds}, got none in '{folder}'"
        )
    print("\n\n".join(texts))


if __name__ == "__main__":
    main()
