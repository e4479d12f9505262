"""The schema of every setting: one dataclass per ``conf/`` group and per recipe.

Values live in ``conf/``, and so does what each key means, as a comment above it;
types and ranges live here. Fields are ``MISSING`` so that a value that no YAML
gives is an error and not a hidden default.
"""

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from toponav.config.checks import (
    Settings as Settings,
    SettingsError as SettingsError,
    TrainingError as TrainingError,
    a_seed as a_seed,
    above as above,
    at_least as at_least,
    between as between,
    one_of as one_of,
    read_yaml as read_yaml,
    refusing as refusing,
    require as require,
    require_finite as require_finite,
    require_multiple as require_multiple,
    threshold_or as threshold_or,
)
from toponav.config.explore import (
    ExploreCollectConfig as ExploreCollectConfig,
    ExploreConfig as ExploreConfig,
    MapConfig as MapConfig,
    OnlineConfig as OnlineConfig,
)
from toponav.config.groups import (
    LearnerConfig as LearnerConfig,
    MazeConfig as MazeConfig,
    ModelConfig as ModelConfig,
    PairsConfig as PairsConfig,
    RewardConfig as RewardConfig,
    WorldConfig as WorldConfig,
    maze_label as maze_label,
)
from toponav.config.navigate import (
    NavigateConfig as NavigateConfig,
    NavigateVideoConfig as NavigateVideoConfig,
    NavigatorConfig as NavigatorConfig,
    SweepReportConfig as SweepReportConfig,
    TourConfig as TourConfig,
    run_setting as run_setting,
)
from toponav.config.practise import (
    PracticeConfig as PracticeConfig,
    PractiseConfig as PractiseConfig,
)
from toponav.config.pretrain import (
    PretrainConfig as PretrainConfig,
    TrainConfig as TrainConfig,
)
from toponav.config.reproduce import (
    ExperimentConfig as ExperimentConfig,
    PaperConfig as PaperConfig,
    ReproduceConfig as ReproduceConfig,
    RowConfig as RowConfig,
    maze_words as maze_words,
    paper_figures as paper_figures,
)

#: Recipe name -> schema of its settings.
RECIPES: dict[str, type] = {
    "explore": ExploreConfig,
    "navigate": NavigateConfig,
    "practise": PractiseConfig,
    "pretrain": PretrainConfig,
    "report": SweepReportConfig,
    "reproduce": ReproduceConfig,
    "tour": TourConfig,
}


def register() -> None:
    """Put the schema into Hydra's store, where the YAML files find it."""
    for resolver in (maze_label, run_setting):
        OmegaConf.register_new_resolver(resolver.__name__, resolver, replace=True)
    store = ConfigStore.instance()
    store.store(group="maze", name="schema", node=MazeConfig)
    store.store(group="model", name="schema", node=ModelConfig)
    store.store(group="experiment", name="schema", node=ExperimentConfig)
    for name, schema in RECIPES.items():
        store.store(name=f"{name}_schema", node=schema)
