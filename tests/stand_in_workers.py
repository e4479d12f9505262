"""Collecting processes in which the stand-in device is known."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from tests.stand_in_device import StandInDevice
from toponav.training import explore_collector, prepare_worker


def prepare_there(*arguments: Any, **given: Any) -> dict[str, Any]:
    """`prepare_worker`, in a process that knows the device from then on."""
    StandInDevice().__enter__()
    return prepare_worker(*arguments, **given)


@contextmanager
def stand_in_workers() -> Iterator[None]:
    """The stand-in device for this process and those that collect for it."""
    name = "prepare_worker"
    with StandInDevice(), mock.patch.object(explore_collector, name, prepare_there):
        yield
