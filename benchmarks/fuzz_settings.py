"""Command lines of the recipes for `fuzz`, run up to where engines would start."""

import importlib
import json
import os
import random
import shutil
import string
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from fuzz_cases import ROOT, Accepted, Case
from fuzz_given import EXPLORED, SWEEP, given
from hydra._internal.core_plugins import basic_launcher
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import run_job
from omegaconf import OmegaConf

from toponav import experiments, reports, training
from toponav.envs import ENGINES, load_engine

NUMBERS = (
    *("-1", "0", "1", "2", "1000000", "99999999999999999999", "-99999999999999999999"),
    *("1e400", "nan", "inf", "-inf", "0.5", "1e-400", "2147483648", "4294967296"),
    *("9223372036854775807", "1_000", "0x10"),
)
WORDS = (
    *("null", "true", "''", "'a b'", "[1,2]", "[]", "{a:1}", "[a", "{", "???", "*"),
    *(
        "${seed}",
        "${nowhere}",
        "${now:%Y}",
        "${",
        "\\",
        "'",
        '"',
        "a,b",
        "=3",
        "é",
        "\n",
    ),
    *("\x01", "x" * 3000, "../..", "/", "/dev/null", "/proc/x", "~", "auto", "maze9"),
)
#: What Hydra itself must refuse, or take.
WHOLE = (
    *("=3", "=", "+", "~", "~seed", "++", "+foo=1", "++foo=1", "+maze.foo=1", "--zz"),
    *(
        "~maze",
        "~maze.apples",
        "maze",
        "maze=",
        "maze=[]",
        "maze=none",
        "@a=b",
        "a@b=c",
    ),
    *("scale=none", "scale=[a,b]", "hydra.run.dir=/proc/x", "hydra.run.dir=''", "seed"),
    *("hydra.run.dir=/dev/null/x", "hydra.foo=1", "hydra=x", "+hydra.foo=1", "--cfg"),
    *("resume=/nowhere", "resume=/dev/null", "-m", "hydra.job.num=x", "a.b.c.d=1"),
    *("hydra.output_subdir=null", "hydra.verbose=x", "-cn", "-cd=/nowhere", "."),
)
#: What a sweep (``-m``) makes jobs of, or cannot.
SEVERAL = (
    *("range(0,3)", "range(0,0)", "choice(-1,1)", "choice()", "glob(*)", "1,,2", ","),
    *("interval(0,1)", "shuffle(1,2)", "sort(2,1)", "[1],[2]", "[],[a]", "1,1", "a,"),
)
#: Settings of a sweep's own.
OF_SWEEPS = (
    *("hydra.sweep.dir=/proc/x", "hydra.sweep.dir=''", "hydra.sweep.dir=/dev/null/x"),
    *("hydra.sweep.subdir=x", "hydra.sweep.subdir=''", "hydra.sweep.subdir=/proc/x"),
    *("hydra.sweeper.max_batch_size=0", "hydra.sweeper.params=3", "hydra.sweep=x"),
    *("hydra/launcher=x", "hydra/launcher=joblib", "hydra/sweeper=x", "hydra.mode=x"),
    *("hydra.sweeper.params={seed:'0,1'}", "hydra.sweeper.params={seed:'0,-1'}"),
)
#: Dotted names of the settings of each recipe, with words that they take; `fuzz` fills
#: them in first.
KEYS: dict[str, dict[str, str]] = {}
USUAL: dict[str, list[str]] = {
    "explore": ["reward=random"],
    "pretrain": ["model.embedding_dim=8"],
    "tour": [],
    "navigate": [],
    "practise": [],
    "report": [],
    "reproduce": ["rows=[novelty]", "most_mazes=1", "seeds=1", "tries=0"],
}
#: Recipes that start from finished runs, with words that are good or bad by what these
#: hold; ``{given}`` stands for the folder of `fuzz_given`.
OWN: dict[str, tuple[str, ...]] = {
    "navigate": (
        *("run={given}/bare", "run={given}/practised"),
        *("navigator=oracle", "navigator=random", "navigator=trained", "navigator=x"),
        *("navigator.practised={given}/practised", "navigator.practised={given}"),
        *("navigator.edge_trials=false", "navigator.see_ground=false", "maze=maze1"),
        *("navigator.block_on=edge", "navigator.hops=0", "navigator.poses=1"),
        *("navigator.temperature=0", "navigator.lookahead=1", "navigator.lost=1"),
        *("goals.source=walk", "goals.source=x", "goals.views=16", "goals.views=17"),
        *("evaluate.policies=[random]", "evaluate.policies=[navigator,perfect_map]"),
        *("evaluate.policies=[x]", "evaluate.policies=[topological,poses]"),
        *("evaluate.policies=[random,random]", "evaluate.policies=[perfect_place_map]"),
        *("evaluate.trained=[a:{given}/explored]", "evaluate.trained=[a]"),
        *("evaluate.trained=[random:/nowhere]", "evaluate.trained=['a:b','a:b']"),
        *("maze.blocked=[a]", "maze.blocked=[a,a]", "maze.blocked=[z]", "maze=random"),
        *("maze.path={given}/bare/ring.txt", "maze.path=/nowhere", "maze.goal=false"),
        *("maze.apples=3", "maze.apples=1000", "maze.texture_seed=1", "maze.marks=0.5"),
        *("engine=dmlab", "engine=vizdom", "video.decisions=0", "video.format=gif"),
    ),
    "practise": (
        *("run={given}/bare", "run={given}/practised"),
        *("navigator=topological", "navigator=oracle", "navigator.temperature=0"),
        *("navigator.practised={given}/practised", "navigator.see_ground=false"),
        *("navigator.edge_trials=false", "navigator.poses=1", "navigator.lost=1"),
        *("practice.envs=1", "practice.rollout=2", "practice.rollout=1", "maze=maze1"),
        *("practice.minibatch=1", "practice.minibatch=4096", "practice.decisions=1"),
        *("practice.confirm=1", "practice.gamma=1", "practice.lr=0", "maze.goal=true"),
        *("maze.blocked=[a]", "maze.blocked=[z]", "maze.apples=3", "engine=dmlab"),
    ),
    "report": (
        *("folder={given}/explored", "folder={given}/practised", "folder=sweep/x"),
        *("folder=sweep/maze=maze3,seed=0", "folder=.", "sweep", "sweep/k=2,seed=0"),
        *("draws=1", "draws=2", "draws=10", "draws=1e3", "draws=2.5", "scale=laptop"),
        *("draws=1000001", "scale=x", "hydra.run.dir=x", "draws=null", "scale=paper"),
    ),
}
#: Of which further usual words some are drawn; each has settings of its own.
VARIANTS = {
    "explore": [
        *("", "loss=a3c", "loss=trpo", "loss=dqn", "loss=drqn"),
        "loss=nav_a3c reward=extrinsic maze.goal=true",
        "loss=nav_a3c_d2l reward=extrinsic maze.goal=true",
    ],
    "navigate": ["navigator=poses"] * 2 + ["navigator=topological"],
}


def settings_case(number: int, draw: random.Random, work: Path) -> Case:
    """A command line with one to three settings that are not usual, or a sweep."""
    recipe = draw.choice(["explore", *USUAL])
    # Drawn apart: the cases of recipes with none of it are made of the same words.
    apart = random.Random(f"apart {number}")
    usual = [*USUAL[recipe]]
    variant = apart.choice(VARIANTS.get(recipe, [""]))
    keys = KEYS[f"{recipe} {variant}".strip()]
    usual += variant.split()
    if recipe in OWN:
        usual.append(start_of(recipe, work))
        own = tuple(word.format(given=given()) for word in OWN[recipe])
        words = own_words(keys, apart, own)
    else:
        words = drawn_words(keys, draw)
        if draw.random() < 0.1:
            words += ["world=gym", "world.id=CartPole-v1"]
        if variant:
            key = apart.choice([one for one in keys if one.startswith("loss.")])
            word = f"{key}={near(keys[key], apart)}"
            # Now and then alone, so that it decides.
            words = apart.choice([[word], *[[*words, word]] * 2])
    if apart.random() < 0.15:
        words = sweep_words(keys, apart)
    folder = work / f"run-{number}"
    line = ["scale=smoke", *usual, *words]
    line.insert(0, f"hydra.sweep.dir={folder}")
    if recipe != "report":  # which writes into the folder that it reports on
        line.insert(0, f"hydra.run.dir={folder}")
    if words[0] in ("-m", "--multirun"):  # no flag may stand between settings
        line.insert(0, line.pop(line.index(words[0])))
    what = " ".join(filter(None, [recipe, variant, *words]))
    what = what.replace(str(given()), "{given}")[:200]
    return Case(number, "settings", what, lambda: run_recipe(recipe, line))


def start_of(recipe: str, work: Path) -> str:
    """The setting that names the runs that a recipe starts from."""
    if recipe != "report":
        return f"run={given() / EXPLORED}"
    shutil.copytree(given() / SWEEP, work / SWEEP)
    return f"folder={SWEEP}"


def drawn_words(keys: Iterable[str], draw: random.Random) -> list[str]:
    """One to three settings by chance."""
    words = []
    for _ in range(draw.choice([1, 1, 2, 3])):
        key, value = draw.choice([*keys]), draw.choice([*NUMBERS, *WORDS])
        typo = key[:-1] + draw.choice(string.ascii_lowercase)
        key = draw.choice([key] * 8 + [typo, "+" + key, "+" + typo])
        words.append(draw.choice([f"{key}={value}"] * 5 + [draw.choice(WHOLE)]))
    return words


def own_words(
    keys: Mapping[str, str], draw: random.Random, own: Sequence[str]
) -> list[str]:
    """One to three settings: ``own`` ones, values near usual ones, and a few others."""
    words = []
    for _ in range(draw.choice([1, 1, 2, 3])):
        key = draw.choice([*keys])
        some = [draw.choice(own), f"{key}={near(keys[key], draw)}"]
        words.append(draw.choice([*some, *some, *drawn_words(keys, draw)[:1]]))
    return words


def near(word: str, draw: random.Random) -> str:
    """Another word for a value of the same type."""
    value = None
    with suppress(ValueError):  # a text
        value = json.loads(word)
    if isinstance(value, bool):
        return json.dumps(not value)
    if isinstance(value, int):
        return str(draw.choice([0, 1, value - 1, value + 1, 2 * value, value // 2]))
    if isinstance(value, float):
        return str(draw.choice([0.0, 1.0, -value, 0.5 * value, 2 * value, 10 * value]))
    return draw.choice([word, "null", "1"])


def sweep_words(keys: Mapping[str, str], draw: random.Random) -> list[str]:
    """A sweep over one or two settings, good words and bad ones, and its flag."""
    words = []
    for key in draw.sample([*keys], draw.choice([1, 1, 2])):
        good = [keys[key]] * 3
        some = [
            draw.choice([*good, draw.choice(NUMBERS), draw.choice([*NUMBERS, *WORDS])])
            for _ in range(draw.choice([1, 2, 2, 3]))
        ]
        some = [",".join(some)]
        words.append(f"{key}={draw.choice([*some * 4, draw.choice(SEVERAL)])}")
    words += draw.choice([[]] * 4 + [["seed=0,1"], [draw.choice(OF_SWEEPS)]])
    flag = draw.choice(["-m", "-m", "--multirun"])
    return draw.choice([[flag, *words], [*words, flag]])


def leaves(recipe: str, *words: str) -> dict[str, str]:
    """Dotted names of a recipe's settings, and words for the values that they have."""
    from hydra import compose, initialize_config_dir

    from toponav.methods import register

    register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose(recipe, overrides=list(words))
    found: dict[str, str] = {}

    def walk(entries: Any, prefix: str) -> None:
        for key, value in entries.items():
            if isinstance(value, dict):
                walk(value, f"{prefix}{key}.")
            else:
                word = f"'{value}'" if isinstance(value, str) else json.dumps(value)
                found[f"{prefix}{key}"] = word

    walk(OmegaConf.to_container(cfg, resolve=False), "")
    return found


def learn_keys() -> None:
    """Fill `KEYS` in."""
    for recipe in USUAL:
        for variant in VARIANTS.get(recipe, [""]):
            KEYS[f"{recipe} {variant}".strip()] = leaves(recipe, *variant.split())


def run_recipe(recipe: str, words: list[str]) -> None:
    """The main function of a recipe's script, up to where engines would start."""

    def stop(*_: object, **__: object) -> None:
        raise Accepted

    script = importlib.import_module(f"recipes.{recipe}")
    # What would be played in the meantime; the first of the others ends the recipe.
    reports.start_baselines = lambda *_: None  # type: ignore[assignment]
    ends = ("make_explore_collector", "collect_held_out", "make_env", "make_game_env")
    # A job that is over must wait for all that it started.
    sweeps = {"-m", "--multirun"} & {*words}
    for name in (*ends, "scripted_of", *(["collect_frames"] if sweeps else [])):
        for owner in (script, experiments, reports, training):
            if hasattr(owner, name):
                setattr(owner, name, stop)
    # The other recipes come to where a maze has been checked, and its games begin.
    for engine in ENGINES:
        object.__setattr__(load_engine(engine), "prepare", stop)
    if hasattr(script, "summarize_scores"):
        # Tables of many bootstrap samples take minutes.
        few = partial(summarize_few, script.summarize_scores)
        setattr(script, "summarize_scores", few)  # noqa: B010
    setattr(basic_launcher, "run_job", run_next)  # noqa: B010
    sys.argv = [f"{recipe}.py", *words]
    script.main()


def summarize_few(summarize: Callable[..., Any], *groups: Any, **arguments: Any) -> Any:
    """A table as `toponav.metrics.summarize_scores` makes it, of 10 samples at most."""
    arguments["draws"] = min(arguments["draws"], 10)
    return summarize(*groups, **arguments)


def run_next(task_function: Callable[[Any], object], **arguments: Any) -> Any:
    """A job of a sweep: one that comes to where engines would start is over.

    What it left and printed until then is taken back: a refusal of other jobs is to be
    seen alone.
    """

    def run(cfg: Any) -> None:
        begin, before = os.lseek(2, 0, os.SEEK_CUR), {*Path.cwd().rglob("*")}
        try:
            task_function(cfg)
        except Accepted:
            shutil.rmtree(HydraConfig.get().runtime.output_dir, ignore_errors=True)
            # Tables are written elsewhere.
            for path in {*Path.cwd().rglob("*")} - before:
                shutil.rmtree(path, ignore_errors=True)
            sys.stderr.flush()
            os.ftruncate(2, begin)
            os.lseek(2, begin, os.SEEK_SET)

    return run_job(task_function=run, **arguments)
