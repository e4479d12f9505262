"""`evaluating`: trained policies are evaluated while the run finishes its map."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
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

    For each policy a process of its own plays them, with copies of all networks as they
    are now, since evaluating and finishing both draw from torch's global random state.
    A few are played here, in `result`. ``show`` is called with the share of all
    decisions that are played.
    """

    def __init__(
        self,
        settings: ExploreConfig,
        world: World,
        explorer: Explorer,
        policies: Mapping[str, TensorDictModuleBase],
        *,
        show: Callable[[float], object] = lambda _: None,
    ) -> None:
        self.settings, self.world = settings, world
        self.explorer, self.policies = explorer, policies
        self.besides = dict[str, Beside[list[Evaluation]]]()
        self._bar, self._played = PlayingBar(), Counter[str]()
        self._show_share = show
        self._shows = threading.Lock()  # each process is heard in a thread
        episodes = len(policies) * settings.evaluate.episodes
        if episodes * world.episode_length < FEW:
            return
        modules = {name: _copy(one) for name, one in explorer.modules().items()}
        for name, policy in policies.items():
            try:
                self.besides[name] = Beside(
                    _evaluate,
                    settings,
                    world,
                    modules,
                    {name: _copy(policy)},
                    heard=self._show,
                    threads=torch.get_num_threads(),
                )
            except BesideError as error:
                _say(name, error)

    def result(self) -> list[Evaluation]:
        """All episodes; waits for the processes, and plays what they have not."""
        if not self.besides:
            return self._play(self.policies, self._show_all)
        return [one for name in self.policies for one in self._result_of(name)]

    def _result_of(self, name: str) -> list[Evaluation]:
        if name in self.besides:
            try:
                return self.besides[name].result()
            except BesideError as error:
                _say(name, error)
        return self._play({name: self.policies[name]}, self._show)

    def _play(
        self, policies: Mapping[str, TensorDictModuleBase], progress: Progress
    ) -> list[Evaluation]:
        known = self.settings, self.world, self.explorer
        return evaluate_policies(*known, policies, progress)

    def _show(self, name: str, done: int, total: int) -> None:
        """One line for all of them, each of which plays as many decisions."""
        names, number = ", ".join(self.policies), len(self.policies)
        with self._shows:
            self._played[name] = done
            self._show_all(names, self._played.total(), number * total)

    def _show_all(self, name: str, done: int, total: int) -> None:
        self._bar(name, done, total)
        self._show_share(done / total)

    def close(self) -> None:
        """End the processes, if there are any."""
        for beside in self.besides.values():
            beside.close()
        self._bar.close()


@contextmanager
def evaluating(
    settings: ExploreConfig,
    world: World,
    explorer: Explorer,
    policies: Mapping[str, TensorDictModuleBase],
    *,
    show: Callable[[float], object] = lambda _: None,
) -> Iterator[EvaluationBeside]:
    """Evaluate policies beside what the block does; it ends with the block."""
    known = settings, world, explorer, policies
    with closing(EvaluationBeside(*known, show=show)) as evaluation:
        yield evaluation


def _evaluate(
    tell: Progress,
    settings: ExploreConfig,
    world: World,
    modules: Weights,
    policies: Weights,
) -> list[Evaluation]:
    """What a process beside the run does."""
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


def _copy(module: nn.Module) -> dict[str, Tensor]:
    return {key: entry.cpu().clone() for key, entry in module.state_dict().items()}


def _say(name: str, error: BesideError) -> None:
    tqdm.write(
        f"policy {name} must be evaluated beside the run, got: {error}; "
        "it is evaluated now"
    )
