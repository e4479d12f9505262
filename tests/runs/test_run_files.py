import csv
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from toponav.reports import write_measurements
from toponav.runs import make_loggers, write_history


def measurement(update: int, **more: float) -> dict[str, float]:
    return {"update": update, "loss_tc": 0.7 / update, "l_accuracy_1": 0.5} | more


def test_measurements_are_a_table_a_picture_and_logs(tmp_path: Path) -> None:
    history = [measurement(1), measurement(2)]
    write_measurements(tmp_path, make_loggers(tmp_path, 0), history)
    with (tmp_path / "metrics.csv").open() as file:
        assert [row["loss_tc"] for row in csv.DictReader(file)] == ["0.7", "0.35"]
    assert (tmp_path / "curves.png").stat().st_size > 1000
    log = tmp_path / "logs/csv/scalars/pretrain/loss_tc.csv"
    assert log.read_text() == "2,0.35\n"


def test_what_was_logged_after_a_checkpoint_is_not_there_twice(tmp_path: Path) -> None:
    # The first run is cut off after update 4, and goes on from a checkpoint of 2.
    for start, *updates in ((0, 1, 2, 4), (2, 4, 5)):
        loggers = make_loggers(tmp_path, start)
        for update in updates:
            write_measurements(tmp_path, loggers, [measurement(update)])
        for logger in loggers:
            getattr(logger.experiment, "flush", str)()
        if not start:
            half = tmp_path / "logs/csv/scalars/pretrain/l_accuracy_1.csv"
            half.write_text(half.read_text() + "5,0.")
    log = tmp_path / "logs/csv/scalars/pretrain/loss_tc.csv"
    logged = [line.partition(",")[0] for line in log.read_text().splitlines()]
    assert logged == ["1", "2", "4", "5"]
    assert half.read_text() == "1,0.5\n2,0.5\n4,0.5\n5,0.5\n"
    board = EventAccumulator(str(tmp_path / "logs/tensorboard")).Reload()
    steps = [one.step for one in board.Scalars("pretrain/loss_tc")]
    assert steps == [1, 2, 4, 5]


@pytest.mark.parametrize(
    "damaged",
    [
        b"\0\0\0\0\n",
        b"\0\0\0\x002,0.4\n",
        b"\xff\xfe,0.4\n",
        b"2,\xff\n",
        *(b"2\n", b"\n", b"2,\n", b"2,0.4,3,0.3\n", b"2.5,0.4\n", b"2,0.\r4\n"),
        b"9" * 5000 + b",0.4\n",
    ],
)
def test_damaged_rows_of_a_log_are_dropped(tmp_path: Path, damaged: bytes) -> None:
    log = tmp_path / "logs/csv/scalars/pretrain/loss_tc.csv"
    log.parent.mkdir(parents=True)
    log.write_bytes(b"1,0.7\n" + damaged + b"3,nan\n4,0.2\n")
    write_measurements(tmp_path, make_loggers(tmp_path, 3), [measurement(4)])
    assert log.read_text() == "1,0.7\n3,nan\n4,0.175\n"


def test_rows_that_lack_a_column_leave_it_empty(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    write_history(path, [measurement(1), measurement(2, extra=1.0)])
    assert path.read_text().splitlines()[1:] == ["1,0.7,0.5,", "2,0.35,0.5,1"]
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.csv"]
