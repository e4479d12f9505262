"""What is chosen by name, one file a method: rewards, learners, worlds, navigators."""

from hydra.core.config_store import ConfigStore

from toponav import config
from toponav.methods.explored import read_explored as read_explored
from toponav.methods.learners import (
    LEARNERS as LEARNERS,
    ActorCriticLearner as ActorCriticLearner,
)
from toponav.methods.navigators import NAVIGATORS
from toponav.methods.rewards import REWARDS as REWARDS, make_reward as make_reward
from toponav.methods.worlds import (
    WORLDS,
    make_world as make_world,
    make_worlds as make_worlds,
)

#: By the group in ``conf/`` and the method's name there, the schema of its settings.
METHODS: dict[str, dict[str, type]] = {
    "loss": {name: method.schema for name, method in LEARNERS.items()},
    "navigator": {name: method.schema for name, method in NAVIGATORS.items()},
    "reward": {name: method.schema for name, method in REWARDS.items()},
    "world": {name: method.schema for name, method in WORLDS.items()},
}


def register() -> None:
    """Put all schemas into Hydra's store, where ``conf/`` finds them."""
    config.register()
    store = ConfigStore.instance()
    for group, schemas in METHODS.items():
        for name, schema in schemas.items():
            store.store(group=group, name=f"{name}_schema", node=schema)
