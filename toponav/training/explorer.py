"""The explorer and its environments."""

from collections.abc import Callable, Collection

import torch
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import Compose, EnvBase, InitTracker, StepCounter, TransformedEnv
from torchrl.envs.transforms import Transform

from toponav.builders import (
    NETWORKS,
    POLICY,
    Consumer,
    Networks,
    Novelty,
    RewardMethod,
    World,
    for_inference,
    make_empty_novelty,
)
from toponav.collectors import Mailbox, RayMailbox, StaggeredEpisodes
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS, make_reward
from toponav.transforms import (
    AreaDownsample,
    Coverage,
    EmbedViews,
    NoisyTV,
    PlacesVisited,
    PolicyPixels,
    PreviousAction,
    PreviousReward,
)

#: Levels of coverage whose decisions are recorded.
COVERAGE_LEVELS = (0.5, 0.9, 1.0)


class Explorer:
    """A policy, its reward method, and the TC-network if the run has one.

    A reward method with a TC-network of its own shares that.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase,
        reward: RewardMethod,
        networks: Networks | None,
    ) -> None:
        self.policy = policy
        self.reward = reward
        #: Embeds views, for the policy and the map.
        self.novelty = reward.novelty
        if self.novelty is None and networks is not None:
            self.novelty = Novelty(networks.tc)

    def modules(self) -> dict[str, nn.Module]:
        """All that collecting processes fetch, by the name it is published under."""
        networks = {} if self.novelty is None else {NETWORKS: self.novelty}
        return {POLICY: self.policy, **networks, **self.reward.modules()}


def make_explorer(
    settings: ExploreConfig,
    world: World,
    names: Collection[str],
    fill: Callable[[str, nn.Module], object],
    *,
    device: torch.device | str = "cpu",
) -> Explorer:
    """An explorer like that of another process, whose modules have these ``names``.

    ``fill`` puts that process's weights into each module, on ``device`` and in the
    precision to use it in there.
    """
    policy = LEARNERS[settings.loss.name].make_policy(settings, world)
    explorer = Explorer(policy, make_reward(settings, world, None), None)
    if explorer.novelty is None and NETWORKS in names:
        explorer.novelty = make_empty_novelty(settings.model, world.spec)
    for module in explorer.modules().values():
        module.to(device)
    if explorer.novelty is not None:
        for_inference(explorer.novelty, settings.model)
    for name, module in explorer.modules().items():
        fill(name, module)
    return explorer


def publish(
    mailbox: Mailbox | RayMailbox,
    explorer: Explorer,
    consumers: Collection[Consumer],
) -> dict[str, int]:
    """Publish what consumers have updated; the new versions, which all of them get."""
    names = {name for one in consumers for name in one.updated()}
    versions = {
        name: mailbox.publish(name, module)
        for name, module in explorer.modules().items()
        if name in names
    }
    for one in consumers:
        one.refresh(versions)
    return versions


def make_explore_env(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    *,
    envs: int,
    seed: int,
    stagger: bool = False,
    teach: bool = False,
    device: torch.device | str = "cpu",
) -> EnvBase:
    """A batch of environments with everything that the explorer and its log read.

    Ground truth (coverage, spurious waypoints, poses) is there for the log alone; no
    network reads a privileged key. The explorer's networks must be in ``eval()`` mode
    and on ``device``, where all tensors go as soon as the engines have drawn.
    ``stagger`` cuts the first episodes at different lengths. ``teach`` adds what the
    learner's losses alone read; its policy does not.

    Raises:
        SettingsError: if the settings do not fit the world.
        EngineError: if the engine cannot start.
    """
    learner = LEARNERS[settings.loss.name]
    env = world.make_env(
        batch_size=envs,
        seed=seed,
        privileged=world.spec.has_positions,
        senses=[*learner.senses, *(learner.taught if teach else ())],
    ).to(device)
    reward, novelty = explorer.reward, explorer.novelty
    transforms: list[Transform] = []
    # The views: with noise if it is wanted, the policy's copy, the networks' copy.
    if settings.collect.noisy_tv:
        transforms.append(NoisyTV(seed=seed))
    if settings.policy.input == "pixels":
        transforms.append(PolicyPixels(size=(settings.policy.view_size,) * 2))
    if novelty is not None:
        transforms.append(AreaDownsample(factor=2 if settings.model.halve else 1))
        if not reward.embeds:
            transforms.append(EmbedViews(novelty.tc.embed))
    transforms += reward.make_transforms(num_envs=envs, seed=seed)
    if teach:
        transforms += learner.make_transforms(settings, world)
    transforms.append(PreviousAction(world.spec.num_actions))
    if world.layout is not None:
        transforms.append(make_coverage(world))
    elif world.spec.place_size is not None:
        transforms.append(PlacesVisited(world.spec.place_size))
    transforms.append(PreviousReward(in_keys=[reward.reward_key]))
    if stagger:
        transforms.append(StaggeredEpisodes(world.episode_length))
    transforms += [InitTracker(), StepCounter()]
    if hasattr(explorer.policy, "make_tensordict_primer"):
        transforms.append(explorer.policy.make_tensordict_primer())
    return TransformedEnv(env, Compose(*transforms))


def make_coverage(world: World) -> Coverage:
    """What measures coverage in a maze."""
    assert world.layout is not None
    slots = list(world.layout.slots.values())
    mask = torch.as_tensor(world.layout.open_mask)
    return Coverage(mask, COVERAGE_LEVELS, slot_cells=slots)
