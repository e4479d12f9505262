"""The schema of every setting: one dataclass per ``conf/`` group and per recipe.

Values live in ``conf/``, and so does what each key means, as a comment above it;
types and ranges live here. Fields are ``MISSING`` so that a value that no YAML
gives is an error and not a hidden default.
"""

from hydra.core.config_store import ConfigStore

from toponav.config.checks import (
    SettingsError,
    TrainingError,
    require,
    require_above_zero,
    require_at_least,
    require_between,
    require_choice,
)
from toponav.config.explore import (
    EvaluateConfig,
    ExploreCollectConfig,
    ExploreConfig,
    LossConfig,
    MapConfig,
    OnlineConfig,
    PolicyConfig,
    PretrainingConfig,
    ReportConfig,
    RewardConfig,
)
from toponav.config.maze import MazeConfig
from toponav.config.navigate import (
    GoalsConfig,
    NavigateConfig,
    NavigateEvaluateConfig,
    NavigateVideoConfig,
    NavigatorConfig,
)
from toponav.config.pretrain import (
    CollectConfig,
    ModelConfig,
    PairsConfig,
    PretrainConfig,
    TrainConfig,
    ValidateConfig,
)
from toponav.config.report import SweepReportConfig
from toponav.config.tour import TourConfig

#: Recipe name -> schema of its settings.
RECIPES: dict[str, type] = {
    "explore": ExploreConfig,
    "navigate": NavigateConfig,
    "pretrain": PretrainConfig,
    "report": SweepReportConfig,
    "tour": TourConfig,
}


def register() -> None:
    """Put the schema into Hydra's store, where the YAML files find it."""
    store = ConfigStore.instance()
    store.store(group="maze", name="schema", node=MazeConfig)
    store.store(group="model", name="schema", node=ModelConfig)
    for name, schema in RECIPES.items():
        store.store(name=f"{name}_schema", node=schema)


__all__ = [
    "RECIPES",
    "CollectConfig",
    "EvaluateConfig",
    "ExploreCollectConfig",
    "ExploreConfig",
    "GoalsConfig",
    "LossConfig",
    "MapConfig",
    "MazeConfig",
    "ModelConfig",
    "NavigateConfig",
    "NavigateEvaluateConfig",
    "NavigateVideoConfig",
    "NavigatorConfig",
    "OnlineConfig",
    "PairsConfig",
    "PolicyConfig",
    "PretrainConfig",
    "PretrainingConfig",
    "ReportConfig",
    "RewardConfig",
    "SettingsError",
    "SweepReportConfig",
    "TourConfig",
    "TrainConfig",
    "TrainingError",
    "ValidateConfig",
    "register",
    "require",
    "require_above_zero",
    "require_at_least",
    "require_between",
    "require_choice",
]
