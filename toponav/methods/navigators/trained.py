"""A policy that `recipes/explore.py` has trained to reach goals, without a map.

It knows nothing of the goal but the reward for it: the rivals of Tables 8 and 9.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial

from omegaconf import MISSING
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.transforms import Transform

from toponav.builders import load_new_policy, make_layout, require_same_maze
from toponav.config import ExploreConfig, NavigateConfig, NavigatorConfig, require
from toponav.keys import ACTION, REWARD
from toponav.methods.explored import read_explored
from toponav.methods.learners import LEARNERS
from toponav.methods.navigators.method import NavigatorMethod
from toponav.methods.worlds import make_world
from toponav.transforms import PolicyPixels, PreviousAction, PreviousReward
from toponav.worlds import WorldSpec


@dataclass
class TrainedConfig(NavigatorConfig):
    """Settings of ``navigator=trained``."""

    policy: str | None = MISSING


class TrainedPolicy(TensorDictModuleBase):
    """A policy of an exploration, and what an environment must show it.

    Args:
        policy: as it was trained.
        settings: of its exploration.
        world: where it acts.
    """

    out_keys = [ACTION]

    def __init__(
        self, policy: TensorDictModuleBase, settings: ExploreConfig, world: WorldSpec
    ) -> None:
        super().__init__()
        self.policy, self.settings, self.world = policy, settings, world
        self.in_keys = list(policy.in_keys)
        #: Senses of the world, beside views, that it reads.
        self.senses: Collection[str] = LEARNERS[settings.loss.name].senses

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        found: TensorDictBase = self.policy(tensordict)
        return found

    def make_transforms(self) -> list[Transform]:
        """What writes its inputs, in an environment of its own."""
        size = self.settings.policy.view_size
        transforms: list[Transform] = [
            PolicyPixels((size, size)),
            PreviousAction(self.world.num_actions),
            PreviousReward(in_keys=[REWARD]),
        ]
        if hasattr(self.policy, "make_tensordict_primer"):
            transforms.append(self.policy.make_tensordict_primer())
        return transforms


def make_trained(
    config: TrainedConfig, *, settings: NavigateConfig, seed: int
) -> TrainedPolicy:
    """The policy that an exploration has kept.

    Raises:
        SettingsError: if ``navigator.policy`` names none that was trained in this maze
            by its own pixels and what the maze pays.
    """
    name = "navigator.policy"
    rule = f"{name} must name the run folder of an exploration"
    require(config.policy is not None, rule, "none")
    folder = str(config.policy)
    explored = read_explored(folder, setting=name)
    rule = f"{name} must name an exploration"
    where = explored.world.name
    require(where == "maze", f"{rule} of a maze", f"'{folder}' with world={where}")
    reward = explored.reward.name
    rule = f"{rule} with reward=extrinsic, so that its policy knows goals"
    require(reward == "extrinsic", rule, f"'{folder}' with reward={reward}")
    given = explored.model if explored.pretrained else None
    explored = explored.resolved(given)
    view = explored.policy.input
    rule = f"{name} must name an exploration with policy.input=pixels"
    require(view == "pixels", rule, f"'{folder}' with {view}")
    engine = settings.engine
    rule = f"{name} must name an exploration with engine={engine}"
    require(explored.engine == engine, rule, f"'{folder}' with {explored.engine}")
    require_same_maze(folder, settings.maze, make_layout(settings.maze))
    world = make_world(explored)
    make = partial(LEARNERS[explored.loss.name].make_policy, explored, world)
    policy = load_new_policy(folder, make, setting=name)
    return TrainedPolicy(policy, explored, world.spec)


TRAINED = NavigatorMethod(schema=TrainedConfig, needs=("settings",), make=make_trained)
