"""A value that no setting takes is one sentence that names the setting and says why."""

from pathlib import Path

import pytest
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from tests.composed import settings
from tests.exploring import explore_settings
from tests.forked import run_forked
from toponav.config import RECIPES, SettingsError
from toponav.envs.layout import MAX_SIDE
from toponav.refusals import sentence_of, settings_of

UNREADABLE = (
    "settings must be written as name=value, with quotes around a value that Hydra "
    "cannot read otherwise,"
)
BAD_WORDS = ("maze.rows=~", "reward.alpha=[1", "maze.apples==3", "maze", "+", 'a="')


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        # Of the recipe itself, of a group, and of the method that was chosen in one.
        ("seed=one", "seed: Value 'one' of type 'str' could not be converted to Int"),
        ("maze.seed=x", "maze.seed: Value 'x' of type 'str' could not be converted to"),
        ("reward.alpha=x", "reward.alpha: Value 'x' of type 'str' could not be conver"),
        ("reward.alpha=${no}", "reward.alpha: Interpolation key 'no' not found"),
        # Another method's, and nobody's.
        ("reward.eta=1", "'reward.eta' must go with reward=icm"),
        ("reward.alpah=1", "'reward.alpah' must be a setting of explore, got none of"),
        # What cannot be read.
        *((word, UNREADABLE + f" got '{word}'") for word in BAD_WORDS),
    ],
)
def test_what_a_setting_does_not_take(word: str, sentence: str) -> None:
    with pytest.raises((HydraException, OmegaConfBaseException)) as refusal:
        explore_settings(word)
    said = sentence_of(refusal.value, "explore")
    assert said is not None
    assert said.startswith(sentence)
    assert "\n" not in said


def refusal_of(line: str) -> str:
    """What is said against the settings of a command line."""
    recipe, *words = line.split()
    maze = ["maze=maze1"] if recipe in ("navigate", "practise") else []
    with pytest.raises(SettingsError) as refusal:
        settings(recipe, *maze, *words)
    return str(refusal.value)


#: All settings that say how many threads a process has.
THREADS = [
    f"{recipe} {name}"
    for recipe, schema in RECIPES.items()
    for name in settings_of(schema)
    if name.rpartition(".")[2] == "threads"
]


def test_all_settings_of_threads_are_looked_at() -> None:
    assert {"explore threads", "pretrain train.threads"} <= {*THREADS}
    assert len(THREADS) == 4


@pytest.mark.parametrize("setting", THREADS)
def test_more_threads_than_any_machine_has_are_refused(setting: str) -> None:
    recipe, name = setting.split()
    said = refusal_of(f"{recipe} {name}=1025")
    assert said == f"{name} must be at most 1,024, got 1025"
    maze = ["maze=maze1"] if recipe in ("navigate", "practise") else []
    settings(recipe, *maze, f"{name}=1024")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("explore loss.lr=1e400", "loss.lr must be a finite number, got inf"),
        ("explore loss.lr=nan", "loss.lr must be a finite number, got nan"),
        ("explore loss.final_lr=-inf", "loss.final_lr must be a finite number, got -i"),
        ("explore reward.alpha=nan", "reward.alpha must be a finite number, got nan"),
        ("explore reward.beta=inf", "reward.beta must be a finite number, got inf"),
        ("explore collect.minutes=nan", "collect.minutes must be a finite number, got"),
        ("explore online.buffer_gb=inf", "online.buffer_gb must be a finite number, g"),
        ("explore map.turn_tolerance=nan", "map.turn_tolerance must be a finite numbe"),
        ("pretrain train.lr=1e999", "train.lr must be a finite number, got inf"),
        ("pretrain collect.share=nan", "collect.share must be a finite number, got n"),
        ("practise practice.gamma=inf", "practice.gamma must be a finite number, got"),
        ("reproduce explore_s.ppo=inf", "explore_s.ppo must be a finite number, got "),
        ("reproduce poll_s=inf", "poll_s must be a finite number, got inf"),
        # Finite numbers that no machine has room for.
        ("explore online.buffer_gb=1e300", "online.buffer_gb must be at most 100,000,"),
        ("pretrain collect.buffer_gb=1e20", "collect.buffer_gb must be at most 100,00"),
        ("pretrain collect.share=1.5", "collect.share must be at most 1, got 1.5"),
        (
            "explore locomotion.pairs=1000001",
            "locomotion.pairs must be at most 1,000,0",
        ),
        ("explore policy.layers=65", "policy.layers must be at most 64, got 65"),
        ("explore evaluate.episodes=100001", "evaluate.episodes must be at most 100,0"),
        ("pretrain pairs.per_update=1000001", "pairs.per_update must be at most 1,"),
        # Finite numbers that float32 has no room for, once they are multiplied by some.
        ("explore loss.lr=1e39", "loss.lr must be at most 1e+30 in size, got 1e+39"),
        ("explore loss.entropy_coeff=1e39", "loss.entropy_coeff must be at most 1e+30"),
        ("explore loss.critic_coeff=1e39", "loss.critic_coeff must be at most 1e+30 i"),
        ("explore map.untraversed_edge_cost=1e39", "map.untraversed_edge_cost must be"),
        ("explore reward.beta=1e39", "reward.beta must be at most 1e+30 in size, got"),
        ("pretrain train.lr=1e39", "train.lr must be at most 1e+30 in size, got 1e+39"),
        ("practise practice.lr=1e39", "practice.lr must be at most 1e+30 in size, got"),
        # Whole numbers too long for a float.
        (f"tour views={'9' * 400}", f"views must lie in [1, 12], got {'9' * 400} (did"),
    ],
)
def test_numbers_that_are_none_or_too_large(line: str, sentence: str) -> None:
    said = refusal_of(line)
    assert said.startswith(sentence)
    assert ("did you mean" in said) == ("lie in" in sentence)


def test_large_numbers_that_tensors_hold_are_taken() -> None:
    settings("explore", "loss.critic_coeff=1e30", "loss.lr=1e30")


@pytest.mark.parametrize("word", ["train.lr", "train.lr=[", "train.lr=1,2", "=3", "-m"])
def test_a_word_of_the_pretraining_that_gives_no_setting_a_value(word: str) -> None:
    said = refusal_of(f"explore pretraining.overrides=['{word}']")
    rule = "pretraining.overrides must hold words such as train.lr=0.001"
    assert said == f"{rule}, got '{word}'"


@pytest.mark.parametrize(
    "word", ["model=resnet18", "resume=runs/a", "scale=paper", "hydra.run.dir=a"]
)
def test_a_pretraining_gets_some_settings_from_its_exploration(word: str) -> None:
    """Its model came after the word, and hid it; with a resume nothing else counts."""
    assert refusal_of(f"explore pretraining.overrides=['{word}']") == (
        "pretraining.overrides must not hold model, world, scale, resume or hydra.*, "
        f"which are the exploration's, got '{word}'"
    )


@pytest.mark.parametrize("recipe", ["explore", "pretrain"])
def test_mined_pairs_are_at_least_one_of_each_kind(recipe: str) -> None:
    said = refusal_of(f"{recipe} pairs.per_update=1")
    assert said == "pairs.per_update must be at least 2 with pairs.mined=true, got 1"
    settings(recipe, "pairs.per_update=2")
    settings(recipe, "pairs.per_update=1", "pairs.mined=false")


@pytest.mark.parametrize("name", ["rows", "cols"])
@pytest.mark.parametrize("recipe", ["explore", "pretrain", "tour"])
def test_a_maze_too_large_names_the_setting(recipe: str, name: str) -> None:
    most = (MAX_SIDE - 1) // 2
    said = refusal_of(f"{recipe} maze=random maze.{name}=1000000")
    assert said == f"maze.{name} must be at most {most}, got 1000000"
    settings(recipe, "maze=random", f"maze.{name}={most}")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            "validate.episodes=100000000",
            "validate.episodes must be at most 1,024, got 100000000",
        ),
        (
            "validate.episodes=5 validate.decisions=200001",
            "validate.episodes * validate.decisions must be at most 1,000,000 views of "
            "each maze, got 1000005",
        ),
        (
            "validate.decisions=99999999999999",
            "validate.episodes * validate.decisions must be at most 1,000,000 views of "
            "each maze, got 1199999999999988",
        ),
    ],
)
def test_more_held_out_episodes_than_fit(words: str, sentence: str) -> None:
    assert refusal_of(f"pretrain {words}") == sentence
    settings("pretrain", "validate.episodes=5", "validate.decisions=200000")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (
            "pretrain train.threads=1000000",
            "train.threads must be at most 1,024, got 1000000",
        ),
        (
            "explore threads=1000000 reward=random",
            "threads must be at most 1,024, got 1000000",
        ),
        (
            "pretrain validate.episodes=100000000",
            "validate.episodes must be at most 1,024, got 100000000",
        ),
        (
            "pretrain collect.buffer_gb=1e300",
            "collect.buffer_gb must be at most 100,000, got 1e+300",
        ),
    ],
)
def test_what_is_too_much_is_refused_before_anything_starts(
    tmp_path: Path, line: str, sentence: str
) -> None:
    recipe, *words = line.split()
    done = run_forked(recipe, "scale=smoke", *words, cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stderr) == (2, f"{recipe}: {sentence}\n")
    assert not list(tmp_path.iterdir())
