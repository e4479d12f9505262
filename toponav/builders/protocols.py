"""Base types of worlds, consumers, learners and reward methods."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform

from toponav.builders.networks import Networks, Novelty
from toponav.builders.processes import make_device
from toponav.config import (
    ExploreConfig,
    LearnerConfig,
    PretrainConfig,
    RewardConfig,
    WorldConfig,
    require,
)
from toponav.envs import Layout
from toponav.worlds import WorldSpec

#: Names of what collecting processes fetch: the explorer's policy, and the TC-network
#: with its threshold.
POLICY, NETWORKS = "policy", "networks"
#: Raises if one of the figures of an update, which it gets by number, is not finite.
Check = Callable[[Mapping[str, float], int], None]


class World(Protocol):
    """Where an agent acts: it makes environments, and says what they are."""

    #: The schema of its settings.
    schema: ClassVar[type[WorldConfig]]
    name: str
    spec: WorldSpec
    episode_length: int
    #: The plan, for evaluation alone; ``None`` in a world without ground truth.
    layout: Layout | None
    #: Letters of its slots that are closed in all episodes.
    blocked: Collection[str] = ()
    #: What its environments can write beside views: ``velocity``, ``depth``.
    senses: Collection[str]

    def __init__(self, settings: ExploreConfig | PretrainConfig) -> None: ...

    @property
    def floor(self) -> Tensor:
        """The plan, bool ``[rows, columns]``, in which `blocked` slots are wall."""
        assert self.layout is not None
        mask = torch.tensor(self.layout.open_mask)
        for letter in self.blocked:
            mask[self.layout.slots[letter]] = False
        return mask

    def make_env(
        self,
        *,
        batch_size: int,
        seed: int,
        privileged: bool = False,
        episode_length: int | None = None,
        senses: Collection[str] = (),
    ) -> EnvBase:
        """A batch of environments; ``privileged`` adds the ground truth, if any.

        ``episode_length`` replaces the world's own, and ``senses``, some of the
        world's, are written, too.
        """
        ...


class Consumer:
    """Takes every batch of an exploration: a learner, a map, a log.

    A run hands each batch to all of its consumers in turn, and keeps their states in
    its checkpoint. Each method may be left as it is.
    """

    #: What it reads of a batch; collectors hand over nothing that nobody reads.
    in_keys: Sequence[NestedKey] = ()
    #: Names of the attributes that a checkpoint keeps: values, or what has a state.
    saved: Sequence[str] = ()
    #: Names of those that are of running episodes, if they are plain values.
    running: Sequence[str] = ()
    #: Whether its `finish` changes nothing that explorers use: it may go on while they
    #: are evaluated.
    finishes_beside = False

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Learn from or remember a batch ``[E, T]``; returns measurements to log."""
        return {}

    def updated(self) -> Collection[str]:
        """Names of the weights that collectors should get now."""
        return ()

    def refresh(self, versions: Mapping[str, int]) -> None:
        """Called when weights were published, with the newest version of each name."""

    def write(self, folder: Path) -> None:
        """Write its files and pictures, now and then and after the last batch."""

    def finish(
        self, folder: Path, progress: Callable[[float], object] = lambda _: None
    ) -> None:
        """Called once when no more batches come; calls ``progress`` with its share."""

    def state_dict(self) -> dict[str, Any]:
        """What another one needs to continue: the states or values of `saved`."""
        parts = {name: getattr(self, name) for name in self.saved}
        return {
            name: part.state_dict() if hasattr(part, "state_dict") else part
            for name, part in parts.items()
        }

    def running_episodes(self) -> dict[str, Any]:
        """What it knows of episodes that are not over; `state_dict` leaves it out."""
        return {name: getattr(self, name) for name in self.running}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        """Called after `load_state_dict` if the episodes of the run go on."""
        for name, value in state.items():
            setattr(self, name, value)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken, with new episodes."""
        for name in self.saved:
            part = getattr(self, name)
            if hasattr(part, "load_state_dict"):
                part.load_state_dict(state[name])
            else:
                setattr(self, name, state[name])


class Learner(Consumer, ABC):
    """A policy and what trains it. One file of ``toponav/methods/learners`` each.

    Args:
        settings: of the run; its own are `config`.
        world: where the explorer acts.
        reward: key of the reward to learn from.
        check: to be called with the losses and the number of the update before every
            step of an optimiser; raises if one is not finite.
        progress: how much of the run is over, in [0, 1].
    """

    #: The schema of its settings.
    schema: ClassVar[type[LearnerConfig]]
    #: Senses of the world, beside views, that its policy reads.
    senses: ClassVar[Collection[str]] = ()
    #: Those that its losses alone read, and no policy that acts.
    taught: ClassVar[Collection[str]] = ()
    config: LearnerConfig
    policy: TensorDictModuleBase

    def __init__(
        self,
        settings: ExploreConfig,
        world: World,
        *,
        reward: NestedKey,
        check: Check,
        progress: Callable[[], float],
    ) -> None:
        assert isinstance(settings.loss, self.schema)
        self.config = settings.loss
        self.require_senses(settings, world)
        self.device = make_device(settings.device)
        self.policy = self.make_policy(settings, world).to(self.device)
        self.reward = reward
        self.check = check
        self.progress = progress

    @classmethod
    def require_senses(cls, settings: ExploreConfig, world: World) -> None:
        """Refuse a world that lacks a sense which its policy or its losses read."""
        needed = dict.fromkeys([*cls.senses, *cls.taught])
        rule = f"loss={settings.loss.name} must have a world that gives "
        lacking = [name for name in needed if name not in world.senses]
        require(not lacking, rule + " and ".join(needed), f"{world.name} without")

    @staticmethod
    @abstractmethod
    def make_policy(settings: ExploreConfig, world: World) -> TensorDictModuleBase:
        """A fresh policy; collecting processes make one too and fetch its weights.

        One with a state has ``make_tensordict_primer()``, which starts it at a reset.
        """

    @staticmethod
    def make_transforms(settings: ExploreConfig, world: World) -> list[Transform]:
        """Transforms that write what its losses alone read, where experience is made.

        The environment gives the ground truth and all that is `taught`.
        """
        return []

    def synchronise(self) -> None:
        """Bring copies of the policy in line with it, after it was given weights."""

    def settle(self, policy: TensorDictModuleBase) -> None:
        """Make a trained policy what it is to be, before it is evaluated and kept."""

    def updated(self) -> Collection[str]:
        return (POLICY,)


class RewardMethod(Consumer):
    """What an explorer is rewarded for. One file of ``toponav/methods/rewards`` each.

    It is built by the learning process, where it learns from batches, and by each
    collecting process, where `make_transforms` puts it into the environments; there
    its `modules` are filled with published weights.

    Args:
        settings: of the run; its own are `config`.
        world: where the explorer acts.
        networks: TC-network and L-network; ``None`` in a run without, and in collecting
            processes.
    """

    #: The schema of its settings; none but its name unless it says so.
    schema: ClassVar[type[RewardConfig]] = RewardConfig
    config: RewardConfig
    #: Whether it cannot do without a TC-network, and pre-trains one if none is given.
    needs_networks: ClassVar[bool] = False
    #: Whether its transforms write the embedding of each view.
    embeds: ClassVar[bool] = False
    #: The column of ``episodes.csv`` by which the best policy is chosen; ``None`` if
    #: rewards of different times cannot be compared, and the last policy is kept.
    selection_metric: ClassVar[str | None] = "intrinsic_return"
    #: Key of the reward that the explorer learns from.
    reward_key: NestedKey
    #: The TC-network that it judges views by, if any; the explorer publishes it.
    novelty: Novelty | None = None

    def __init__(
        self, settings: ExploreConfig, world: World, networks: Networks | None
    ) -> None:
        assert isinstance(settings.reward, self.schema)
        self.config = settings.reward

    def modules(self) -> dict[str, nn.Module]:
        """What else collecting processes need, by the name it is published under."""
        return {}

    def updated(self) -> Collection[str]:
        return tuple(self.modules())

    def recalibrate(self, thresholds: Mapping[str, float]) -> None:
        """Called when the networks that continue training have new thresholds."""

    def make_transforms(self, *, num_envs: int, seed: int) -> list[Transform]:
        """The transforms that write the reward, for one batch of environments."""
        return []

    def episode_sums(self) -> dict[str, NestedKey]:
        """Columns of ``episodes.csv`` to the keys summed over an episode."""
        return {"intrinsic_return": self.reward_key}

    def episode_ends(self) -> dict[str, NestedKey]:
        """Columns of ``episodes.csv`` to keys of an episode's last decision."""
        return {}
