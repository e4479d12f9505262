"""Makes run folders as recipes leave them, for the tests that read them."""

import csv
import json
from pathlib import Path

import yaml


def files_of(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def make_folder(folder: Path, *names: str) -> dict[str, bytes]:
    """A run folder with these files; what is in it."""
    (folder / "config").mkdir(parents=True)
    for name in ("config/overrides.yaml", "config/config.yaml", *names):
        (folder / name).write_text("[]\n" if "overrides" in name else "{}\n")
    return files_of(folder)


def make_run(sweep: Path, recipe: str, *words: str, seed: int = 0) -> Path:
    """A folder with what Hydra writes: the settings, and which recipe it was."""
    words = (*words, f"seed={seed}")
    folder = sweep / ",".join(words).replace("/", "_")
    (folder / "config").mkdir(parents=True)
    config = {"seed": seed, "reward": {"alpha": 0.5}, "maze": {"name": "maze3"}}
    hydra = {"hydra": {"job": {"config_name": recipe}}}
    for name, content in (
        ("overrides", list(words)),
        ("config", config),
        ("hydra", hydra),
    ):
        (folder / f"config/{name}.yaml").write_text(yaml.safe_dump(content))
    return folder


def write_table(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def make_pretraining(
    sweep: Path, *words: str, seed: int = 0, mazes: dict[str, float]
) -> Path:
    """A finished pre-training; ``mazes`` gives the TC accuracy in each."""
    folder = make_run(sweep, "pretrain", *words, seed=seed)
    figures = {
        maze: {
            "accuracy": accuracy,
            "pose_bound": 0.98,
            "through_wall_rate": None,
            "count_1": 3.0,
            "count_2": 1.0,
            "accuracy_1": 0.8,
            "accuracy_2": 0.4,
        }
        for maze, accuracy in mazes.items()
    }
    report = {"mazes": figures, "waypoint_share": {"0.5": 0.05, "0.9": 0.125}}
    (folder / "report.json").write_text(json.dumps(report))
    rows = [
        {"update": 1, "tc_accuracy_k4_m5": 0.5},
        {"update": 2, "tc_accuracy_k4_m5": 0.75},
    ]
    write_table(folder / "metrics.csv", rows)
    return folder


def make_exploration(
    sweep: Path,
    *words: str,
    seed: int = 0,
    best: list[float],
    random: list[float] = (0.4, 0.5),
    training: float = 0.95,
) -> Path:
    """A finished exploration whose training coverage rises to ``training``."""
    folder = make_run(sweep, "explore", *words, seed=seed)
    policies = {"best": best, "last": [x - 0.1 for x in best], "random": random}
    rows = [
        {
            "policy": policy,
            "seed": number,
            "coverage": coverage,
            "decisions_to_90": 900 + number if coverage >= 0.9 else -1,
            "intrinsic_return": 100.0 + seed,
        }
        for policy, values in policies.items()
        for number, coverage in enumerate(values)
    ]
    write_table(folder / "evaluation.csv", rows)
    episodes = [
        {"decisions": 1800 * (n + 1), "coverage": 0.4 if n < 40 else training}
        for n in range(80)
    ]
    write_table(folder / "episodes.csv", episodes)
    return folder
