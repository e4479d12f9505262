import csv
from pathlib import Path

from toponav.reports import write_measurements
from toponav.runs import make_loggers, write_history


def measurement(update: int, **more: float) -> dict[str, float]:
    return {"update": update, "loss_tc": 0.7 / update, "l_accuracy_1": 0.5} | more


def test_measurements_are_a_table_a_picture_and_logs(tmp_path: Path) -> None:
    history = [measurement(1), measurement(2)]
    write_measurements(tmp_path, make_loggers(tmp_path), history)
    with (tmp_path / "metrics.csv").open() as file:
        assert [row["loss_tc"] for row in csv.DictReader(file)] == ["0.7", "0.35"]
    assert (tmp_path / "curves.png").stat().st_size > 1000
    log = tmp_path / "logs/csv/scalars/pretrain/loss_tc.csv"
    assert log.read_text() == "2,0.35\n"


def test_logs_go_on_after_a_restart(tmp_path: Path) -> None:
    for update in (1, 2):
        write_measurements(tmp_path, make_loggers(tmp_path), [measurement(update)])
    log = tmp_path / "logs/csv/scalars/pretrain/loss_tc.csv"
    assert log.read_text() == "1,0.7\n2,0.35\n"


def test_rows_that_lack_a_column_leave_it_empty(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    write_history(path, [measurement(1), measurement(2, extra=1.0)])
    assert path.read_text().splitlines()[1:] == ["1,0.7,0.5,", "2,0.35,0.5,1"]
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.csv"]
