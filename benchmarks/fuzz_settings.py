"""Command lines of the recipes for `fuzz`, run up to where engines would start."""

import importlib
import random
import string
import sys
from pathlib import Path
from typing import Any

from fuzz_cases import ROOT, Accepted, Case
from omegaconf import OmegaConf

from toponav import experiments, reports, training

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
#: Dotted names of the settings of each recipe, which `fuzz` fills in first.
KEYS: dict[str, list[str]] = {}
USUAL: dict[str, list[str]] = {
    "explore": ["reward=random"],
    "pretrain": ["model.embedding_dim=8"],
    "tour": [],
    "navigate": ["maze=maze1"],
    "practise": ["run=/nowhere"],
    "report": ["folder=/nowhere"],
    "reproduce": ["rows=[novelty]", "most_mazes=1", "seeds=1", "tries=0"],
}


def settings_case(number: int, draw: random.Random, work: Path) -> Case:
    """A command line with one to three settings that are not usual."""
    recipe = draw.choice(["explore", *USUAL])
    keys = KEYS[recipe]
    words = []
    for _ in range(draw.choice([1, 1, 2, 3])):
        key, value = draw.choice(keys), draw.choice([*NUMBERS, *WORDS])
        typo = key[:-1] + draw.choice(string.ascii_lowercase)
        key = draw.choice([key] * 8 + [typo, "+" + key, "+" + typo])
        words.append(draw.choice([f"{key}={value}"] * 5 + [draw.choice(WHOLE)]))
    if "-m" in words:
        # Jobs of a sweep have processes of their own, which nothing would stop.
        words.append("seed=-1")
    if draw.random() < 0.1:
        words += ["world=gym", "world.id=CartPole-v1"]
    folder = work / f"run-{number}"
    line = ["scale=smoke", *USUAL[recipe], *words]
    if recipe != "report":  # which writes into the folder that it reports on
        line.insert(0, f"hydra.run.dir={folder}")
    what = f"{recipe} {' '.join(words)}"[:200]
    return Case(number, "settings", what, lambda: run_recipe(recipe, line), folder)


def leaves(recipe: str) -> list[str]:
    """Dotted names of a recipe's settings."""
    from hydra import compose, initialize_config_dir

    from toponav.methods import register

    register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose(recipe, overrides=["maze=maze1"] if recipe == "navigate" else [])
    found: list[str] = []

    def walk(entries: Any, prefix: str) -> None:
        for key, value in entries.items():
            if isinstance(value, dict):
                walk(value, f"{prefix}{key}.")
            else:
                found.append(f"{prefix}{key}")

    walk(OmegaConf.to_container(cfg, resolve=False), "")
    return found


def run_recipe(recipe: str, words: list[str]) -> None:
    """The main function of a recipe's script, up to where engines would start."""

    def stop(*_: object, **__: object) -> None:
        raise Accepted

    script = importlib.import_module(f"recipes.{recipe}")
    # What would be played in the meantime; the first of the others ends the recipe.
    reports.start_baselines = lambda *_: None  # type: ignore[assignment]
    ends = ("make_explore_collector", "collect_held_out", "make_env", "make_game_env")
    for name in (*ends, "scripted_of"):
        for owner in (script, experiments, reports, training):
            if hasattr(owner, name):
                setattr(owner, name, stop)
    sys.argv = [f"{recipe}.py", *words]
    script.main()
