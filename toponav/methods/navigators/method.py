"""`NavigatorMethod`: what a navigator declares."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from tensordict.nn import TensorDictModuleBase

from toponav.builders import GoalPlaces
from toponav.config import NavigatorConfig

Need = Literal["world", "knowledge", "truth", "settings"]


@dataclass(frozen=True, kw_only=True)
class NavigatorMethod:
    """How one navigator is made."""

    #: Of its settings in ``conf/navigator``; `NavigatorConfig` itself if it has none.
    schema: type[NavigatorConfig]
    #: What `make` gets by these names: `WorldSpec`, `AgentKnowledge`, `GroundTruth` or
    #: the run's `NavigateConfig`; the truth is for baselines alone, never for an agent.
    needs: tuple[Need, ...] = ()
    #: From the settings, what it needs and ``seed`` to a policy that reads what
    #: `make_navigation_env` writes.
    make: Callable[..., TensorDictModuleBase]
    #: Whether `make` takes ``edges`` and a ``place_key`` as `make_navigator` does, by
    #: which a diagnosis tells it the truth. What it makes has `Navigator.took`, if it
    #: goes by its last action: a diagnosis may replace that.
    takes_truth: bool = False
    #: From the policy to a sentence about goals that it cannot know.
    warn_of_goals: Callable[[Any, GoalPlaces], str | None] | None = None
