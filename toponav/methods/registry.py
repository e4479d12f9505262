"""Puts the settings of every method into Hydra's store, where ``conf/`` finds them."""

from hydra.core.config_store import ConfigStore

from toponav import config
from toponav.methods.learners import LEARNERS
from toponav.methods.navigators import NAVIGATORS
from toponav.methods.rewards import REWARDS
from toponav.methods.worlds import WORLDS

#: By the group in ``conf/`` and the method's name there, the schema of its settings.
METHODS: dict[str, dict[str, type]] = {
    "loss": {name: method.schema for name, method in LEARNERS.items()},
    "navigator": {name: method.schema for name, method in NAVIGATORS.items()},
    "reward": {name: method.schema for name, method in REWARDS.items()},
    "world": {name: method.schema for name, method in WORLDS.items()},
}


def register() -> None:
    """Register all schemas: those of ``toponav.config`` and of the methods."""
    config.register()
    store = ConfigStore.instance()
    for group, schemas in METHODS.items():
        for name, schema in schemas.items():
            store.store(group=group, name=f"{name}_schema", node=schema)
