"""`evaluating`: trained policies are evaluated while the run finishes its map."""

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from tqdm import tqdm

from toponav.builders import World, prepare_process
from toponav.config import ExploreConfig
from toponav.methods import LEARNERS
from toponav.reports.beside import FEW, Beside, BesideError
from toponav.reports.episodes import PlayingBar, Progress
from toponav.reports.exploration_evaluation import Evaluation, evaluate_policies
from toponav.training import Explorer, make_explorer

#: Weights on the CPU by module, or policy, and name.
Weights = dict[str, dict[str, Tensor]]


class EvaluationBeside:
    """Episodes of trained policies, those of `evaluate_policies`.

    A process of its own plays them, with copies of all networks as they are now, since
    evaluating and finishing both draw from torch's global random state. A few are
    played here, in `result`.
    """

    def __init__(
        self,
        settings: ExploreConfig,
        world: World,
        explorer: Explorer,
        policies: Mapping[str, TensorDictModuleBase],
    ) -> None:
        self.settings, self.world = settings, world
        self.explorer, self.policies = explorer, policies
        self.beside: Beside[list[Evaluation]] | None = None
        self._bar = PlayingBar()
        episodes = len(policies) * settings.evaluate.episodes
        if episodes * world.episode_length < FEW:
            return
        modules = explorer.modules()
        weights: list[Weights] = [
            {
                name: {key: value.cpu().clone() for key, value in entries.items()}
                for name, entries in given.items()
            }
            for given in (
                {name: one.state_dict() for name, one in modules.items()},
                {name: one.state_dict() for name, one in policies.items()},
            )
        ]
        try:
            self.beside = Beside(
                _evaluate,
                settings,
                world,
                *weights,
                heard=self._bar,
                threads=torch.get_num_threads(),
            )
        except BesideError as error:
            _say(error)

    def result(self) -> list[Evaluation]:
        """All episodes; waits for the process, and plays what it has not played."""
        if self.beside is not None:
            try:
                return self.beside.result()
            except BesideError as error:
                self._bar.close()
                _say(error)
        return evaluate_policies(
            self.settings, self.world, self.explorer, self.policies
        )

    def close(self) -> None:
        """End the process, if there is one."""
        if self.beside is not None:
            self.beside.close()
        self._bar.close()


@contextmanager
def evaluating(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    policies: Mapping[str, TensorDictModuleBase],
) -> Iterator[EvaluationBeside]:
    """Evaluate policies beside what the block does; it ends with the block."""
    with closing(EvaluationBeside(settings, world, explorer, policies)) as evaluation:
        yield evaluation


def _evaluate(
    tell: Progress,
    settings: ExploreConfig,
    world: World,
    modules: Weights,
    policies: Weights,
) -> list[Evaluation]:
    """What the process beside the run does."""
    prepare_process(threads=None)
    explorer = make_explorer(
        settings,
        world,
        list(modules),
        lambda name, module: module.load_state_dict(modules[name]),
    )
    learner, made = LEARNERS[settings.loss.name], dict[str, TensorDictModuleBase]()
    for name, weights in policies.items():
        made[name] = learner.make_policy(settings, world)
        made[name].load_state_dict(weights)
    return evaluate_policies(settings, world, explorer, made, tell)


def _say(error: BesideError) -> None:
    tqdm.write(
        f"the policies must be evaluated beside the run, got: {error}; "
        "they are evaluated now"
    )
