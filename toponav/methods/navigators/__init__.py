"""Navigators. A new one is a file here and a line in `NAVIGATORS`."""

from collections.abc import Iterator, Mapping

from tensordict.nn import TensorDictModuleBase

from toponav.builders import AgentKnowledge, GoalPlaces, GroundTruth
from toponav.config import NavigateConfig, NavigatorConfig, require
from toponav.methods.navigators.diagnosis import (
    DIAGNOSES as DIAGNOSES,
    make_diagnosis as make_diagnosis,
)
from toponav.methods.navigators.method import NavigatorMethod as NavigatorMethod
from toponav.methods.navigators.oracle import ORACLE
from toponav.methods.navigators.poses import (
    POSES,
    PosesConfig as PosesConfig,
    make_practising_navigator as make_practising_navigator,
)
from toponav.methods.navigators.random import RANDOM
from toponav.methods.navigators.topological import (
    TOPOLOGICAL,
    TopologicalConfig as TopologicalConfig,
    make_navigator as make_navigator,
)
from toponav.methods.navigators.trained import (
    TRAINED,
    TrainedConfig,
    TrainedPolicy as TrainedPolicy,
)

#: By the name of their settings, ``conf/navigator/<name>.yaml``.
NAVIGATORS = {
    **{"topological": TOPOLOGICAL, "poses": POSES},
    **{"oracle": ORACLE, "random": RANDOM, "trained": TRAINED},
}
#: What ``evaluate.policies`` calls the one that ``navigator`` chooses.
CHOSEN = "navigator"


def make_policies(
    settings: NavigateConfig, knowledge: AgentKnowledge, truth: GroundTruth
) -> dict[str, TensorDictModuleBase]:
    """Who plays, by name, in the order of ``evaluate.policies`` and ``.trained``.

    Only methods that declare the ``truth`` and `DIAGNOSES` get it. Raises
    `SettingsError` if a name is unknown, or of a navigator with settings that
    ``navigator`` does not choose.
    """
    given = {"world": knowledge.world, "knowledge": knowledge, "truth": truth}
    given["settings"] = settings
    policies = dict[str, TensorDictModuleBase]()
    for name in settings.evaluate.policies:
        if name in DIAGNOSES:
            policies[name] = make_diagnosis(
                settings.navigator,
                DIAGNOSES[name],
                make=_diagnosed(name, settings).make,
                knowledge=knowledge,
                truth=truth,
                seed=settings.seed,
            )
            continue
        config = _config(name, settings)
        method = NAVIGATORS[config.name]
        needed = {need: given[need] for need in method.needs}
        policies[name] = method.make(config, **needed, seed=settings.seed)
    for name, trained in _trained(settings).items():
        policies[name] = TRAINED.make(trained, settings=settings, seed=settings.seed)
    return policies


def _trained(settings: NavigateConfig) -> dict[str, TrainedConfig]:
    """The policies of ``evaluate.trained``, by the names that they are given."""
    found = dict[str, TrainedConfig]()
    taken = {*settings.evaluate.policies, CHOSEN, *NAVIGATORS, *DIAGNOSES}
    for entry in settings.evaluate.trained:
        name, _, folder = entry.partition(":")
        rule = "evaluate.trained must have names of their own"
        require(name not in taken | found.keys(), rule, f"'{name}'")
        found[name] = TrainedConfig(name="trained", policy=folder)
    return found


def _config(name: str, settings: NavigateConfig) -> NavigatorConfig:
    """The settings of one policy."""
    chosen = settings.navigator
    if name in (CHOSEN, chosen.name):
        return chosen
    known = (CHOSEN, *NAVIGATORS, *DIAGNOSES)
    require(name in known, f"evaluate.policies must be one of {', '.join(known)}", name)
    rule = "evaluate.policies must name a navigator without settings beside "
    rule += f"{CHOSEN}, which is navigator={chosen.name}"
    require(NAVIGATORS[name].schema is NavigatorConfig, rule, name)
    return NavigatorConfig(name=name)


def _diagnosed(name: str, settings: NavigateConfig) -> NavigatorMethod:
    """The navigator that is told the truth."""
    chosen = settings.navigator.name
    able = [word for word, method in NAVIGATORS.items() if method.takes_truth]
    rule = f"evaluate.policies must name {name} with navigator={' or '.join(able)}"
    require(chosen in able, rule, f"navigator={chosen}")
    return NAVIGATORS[chosen]


def warn_of_goals(
    settings: NavigateConfig,
    policies: Mapping[str, TensorDictModuleBase],
    places: GoalPlaces,
) -> Iterator[str]:
    """What navigators have to say about goals that they cannot know, in sentences."""
    for name, policy in policies.items():
        if name in DIAGNOSES or isinstance(policy, TrainedPolicy):
            continue
        warn = NAVIGATORS[_config(name, settings).name].warn_of_goals
        if warn and (sentence := warn(policy, places)):
            yield sentence
