"""The Ray cluster whose machines collect: whether it can be used, and joining it."""

import os
import signal
import socket
import threading
from typing import Any

from toponav.config import ExploreConfig, SettingsError, require

try:
    import ray
except ImportError:  # `require_cluster` says what to do
    ray = None

# Seconds in which a machine must answer.
_ANSWER_S = 5.0


def require_cluster(settings: ExploreConfig) -> None:
    """Refuse ``collect.backend=ray`` if it could not begin; joins nothing for good.

    Raises:
        SettingsError: if Ray is not installed, cannot start on this machine, or
            ``ray.address`` names no cluster that can be used, or one with too few
            cores.
    """
    address, workers = settings.ray.address, settings.collect.workers
    if settings.collect.backend == "local":
        rule = "ray.address must go with collect.backend=ray"
        require(address is None, rule, "collect.backend=local")
        return
    rule = "collect.backend=ray must have Ray, which pip install 'toponav[ray]' brings"
    require(ray is not None, rule, "no module of that name")
    if address is not None:
        host, _, port = address.rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
        except OSError as error:
            raise _unusable(address, error) from error
    # Before hours of pre-training; one of this machine starts again after them.
    join_cluster(address, workers=workers)
    ray.shutdown()


def join_cluster(address: str | None, *, workers: int) -> None:
    """Connect this process to a Ray cluster, or start one on this machine.

    The one that it starts has a core for each worker, whatever the machine has: they
    then share its cores as processes without Ray do. ``ray.shutdown()`` leaves.

    Raises:
        SettingsError: if the cluster cannot be joined or has too few cores.
    """
    quiet: dict[str, Any] = {"logging_level": "error", "log_to_driver": False}
    if address is None:
        # Nothing of a run is sent to the makers of Ray, whose workers would by default
        # wait for every other program.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_worker_niceness", "0")
        quiet |= {"num_cpus": workers, "include_dashboard": False}
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    try:
        # Without "local" it would join a cluster of others that runs on this machine.
        ray.init(address=address or "local", **quiet)
    except (ray.exceptions.RayError, RuntimeError, OSError, ValueError) as error:
        raise _unusable(address, error) from error
    finally:
        # Ray's own would end the run before it has saved its state.
        if main and before is not None:
            signal.signal(signal.SIGTERM, before)
    cores = int(ray.cluster_resources().get("CPU", 0))
    if workers > cores:
        ray.shutdown()
        rule = f"collect.workers must be at most the {cores} cores of the Ray cluster"
        raise SettingsError(f"{rule}, got {workers}")


def _unusable(address: str | None, error: Exception) -> SettingsError:
    reason = (str(error).strip() or type(error).__name__).splitlines()[0]
    if address is None:
        rule = "collect.backend=ray must be able to start Ray on this machine"
        return SettingsError(f"{rule}, got: {reason}")
    rule = "ray.address must name a Ray cluster that this machine can reach"
    return SettingsError(f"{rule}, got {address} ({reason})")
