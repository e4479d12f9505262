"""What is wrong with ``collect.backend=ray`` is said before anything starts."""

import re
import socket
from types import SimpleNamespace

import pytest

from tests.exploring import explore_settings
from toponav.builders import ray_cluster, require_cluster
from toponav.config import SettingsError

RAY = "collect.backend=ray"


def test_without_ray_a_sentence_names_what_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ray_cluster, "ray", None)
    rule = "must have Ray, which pip install 'toponav[ray]' brings, got no module"
    with pytest.raises(SettingsError, match=re.escape(rule)):
        require_cluster(explore_settings(RAY))
    # What does not need it does not ask for it.
    require_cluster(explore_settings())


def test_a_machine_that_does_not_answer_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ray_cluster, "ray", object())
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    # Nobody listens there any more.
    rule = "must name a Ray cluster that this machine can reach"
    with pytest.raises(SettingsError, match=f"{rule}, got {address} .*refused"):
        require_cluster(explore_settings(RAY, f"ray.address='{address}'"))


def test_a_ray_that_cannot_start_here_is_refused_before_anything_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def init(**_: object) -> None:
        raise RuntimeError("no room for objects\nand more of it")

    errors = SimpleNamespace(RayError=KeyError)
    stub = SimpleNamespace(init=init, exceptions=errors)
    monkeypatch.setattr(ray_cluster, "ray", stub)
    rule = "must be able to start Ray on this machine, got: no room for objects$"
    with pytest.raises(SettingsError, match=rule):
        require_cluster(explore_settings(RAY))


def test_a_ray_that_can_start_here_is_ended_until_it_is_needed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = list[str]()
    stub = SimpleNamespace(
        init=lambda address, **_: done.append(f"begin {address}"),
        cluster_resources=lambda: {"CPU": 2.0},
        shutdown=lambda: done.append("end"),
        exceptions=SimpleNamespace(RayError=KeyError),
    )
    monkeypatch.setattr(ray_cluster, "ray", stub)
    require_cluster(explore_settings(RAY, "collect.workers=2"))
    assert done == ["begin local", "end"]


@pytest.mark.parametrize(
    "address", ["somewhere", "ray://here:10001", "here:port", ":6379", "here:99999"]
)
def test_an_address_is_a_host_and_a_port(address: str) -> None:
    with pytest.raises(SettingsError, match="null or the <host>:<port> of a Ray"):
        explore_settings(RAY, f"ray.address='{address}'")


def test_an_address_goes_with_its_backend() -> None:
    with pytest.raises(
        SettingsError, match=re.escape("go with collect.backend=ray, got")
    ):
        require_cluster(explore_settings("ray.address='localhost:6379'"))
