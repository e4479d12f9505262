"""`PreparedCollector`: a collector that makes its parts where it lives."""

from collections.abc import Callable, Mapping
from typing import Any

from toponav.collectors.mailbox import MailboxCollector


class PreparedCollector(MailboxCollector):
    """A `MailboxCollector` whose networks and environments are built where it lives.

    Args:
        create_env_fn, policy, kwargs: as for `MailboxCollector`.
        prepare: returns the other arguments for the number of this collector and its
            start; they take precedence over ``kwargs``.
        worker_idx: number of this collector among several.
        start: how many collectors had this number before, and died.
        episodes: what `running_episodes` returned of the one to continue.
    """

    _is_built = False

    def __init__(
        self,
        create_env_fn: Any,
        policy: Any = None,
        *,
        prepare: Callable[[int, int], Mapping[str, Any]],
        worker_idx: int,
        start: int = 0,
        episodes: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        arguments = {**kwargs, **prepare(worker_idx, start)}
        super().__init__(create_env_fn, policy, worker_idx=worker_idx, **arguments)
        if episodes is not None:
            self.resume_episodes(episodes)
        self._is_built = True

    def __bool__(self) -> bool:
        # Ray describes an actor that is true beside what its __init__ raised, and ends
        # it without that if TorchRL's description of a half-built one raises, too.
        return self._is_built
