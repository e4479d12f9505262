"""Processes of a run in which the stand-in device is known."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from tests.stand_in_device import StandInDevice
from toponav.reports import evaluation_beside
from toponav.reports.exploration_evaluation import Evaluation
from toponav.training import explore_collector, prepare_worker

_evaluate = evaluation_beside._evaluate


def prepare_there(*arguments: Any, **given: Any) -> dict[str, Any]:
    """`prepare_worker`, in a process that knows the device from then on."""
    StandInDevice().__enter__()
    return prepare_worker(*arguments, **given)


def evaluate_there(*arguments: Any) -> list[Evaluation]:
    """What a process beside the run does, in one that knows the device."""
    with StandInDevice():
        return _evaluate(*arguments)


@contextmanager
def stand_in_workers() -> Iterator[None]:
    """The stand-in device for this process and those that collect for it."""
    name = "prepare_worker"
    with StandInDevice(), mock.patch.object(explore_collector, name, prepare_there):
        yield
