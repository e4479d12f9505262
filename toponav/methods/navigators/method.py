"""`NavigatorMethod`: the base type of navigators."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from tensordict.nn import TensorDictModuleBase

from toponav.builders import GoalPlaces
from toponav.config import NavigatorConfig

Need = Literal["world", "knowledge", "truth"]


@dataclass(frozen=True, kw_only=True)
class NavigatorMethod:
    """How one navigator is made, trained too if it must be.

    Args:
        schema: of its settings in ``conf/navigator``; `NavigatorConfig` itself if it
            has none.
        needs: what `make` gets by these names: ``world`` (`WorldSpec`), ``knowledge``
            (`AgentKnowledge`: map and networks), ``truth`` (`GroundTruth`: for
            baselines alone, never for an agent).
        make: from the settings, what it needs and ``seed`` to a policy that reads what
            `make_navigation_env` writes.
        warn_of_goals: from the policy to a sentence about goals that it cannot know.
    """

    schema: type[NavigatorConfig]
    needs: tuple[Need, ...] = ()
    make: Callable[..., TensorDictModuleBase]
    warn_of_goals: Callable[[Any, GoalPlaces], str | None] | None = None
