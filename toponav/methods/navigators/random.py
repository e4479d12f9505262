"""Random actions: a lower bound."""

from toponav.config import NavigatorConfig
from toponav.methods.navigators.method import NavigatorMethod
from toponav.policies import RandomPolicy
from toponav.worlds import WorldSpec


def make_random(
    config: NavigatorConfig, *, world: WorldSpec, seed: int
) -> RandomPolicy:
    """Knows nothing."""
    return RandomPolicy(world.num_actions, seed=seed)


RANDOM = NavigatorMethod(schema=NavigatorConfig, needs=("world",), make=make_random)
