"""The runs that `faults` kills, and what each of them uses undisturbed."""

import json
import shutil
from pathlib import Path

from fault_place import ROOT, Place, pretraining_of

SMALL = ("scale=smoke", "model.embedding_dim=8", "maze.episode_length=32")
EXPLORE = (
    *("collect.decisions=512", "collect.max_idle_s=200", "policy.hidden=16"),
    *("evaluate.episodes=1", "evaluate.random_episodes=1", "report.every=128"),
    *("report.pictures_every_s=1", "report.save_every_s=0.5"),
)
RUNS: dict[str, tuple[str, ...]] = {
    "explore sync": ("explore", *SMALL, *EXPLORE),
    "explore async": (
        *("explore", *SMALL, *EXPLORE, "collect.mode=async", "collect.workers=2"),
    ),
    # The networks learn, too, as by default at the paper's scale, and another learner.
    "explore learning": (
        *("explore", *SMALL, *EXPLORE, "collect.mode=async", "collect.workers=2"),
        *("online.learn=true", "online.every=64", "online.publish_every=128"),
        "loss=a3c",
    ),
    "pretrain": (
        *("pretrain", *SMALL, "collect.max_idle_s=200", "train.save_every_s=0.01"),
        *("validate.decisions=60", "validate.every=5"),
    ),
    # It ends as the default does: the map is made again by poses, while processes of
    # their own play the evaluation, which has to be long enough for them.
    "explore poses": (
        *("explore", *SMALL, *EXPLORE, "map.poses=true"),
        *("maze.episode_length=128", "evaluate.episodes=160"),
    ),
    # As users start it: kills hit the pre-training, too, which is a process of its own.
    "explore from nothing": (
        *("explore", *SMALL, *EXPLORE, "pretraining.scale=smoke"),
    ),
}


def prepare(work: Path) -> tuple[Path, dict[str, float]]:
    """Networks for explorations, and what each run uses undisturbed."""
    place, file = Place(work / "whole"), work / "seconds.json"
    networks = place.folder / "pretrain" / "networks.pt"
    seconds = json.loads(file.read_text()) if file.exists() else {}
    # The first makes the networks of the others.
    for name in sorted(RUNS, key=lambda name: name != "pretrain"):
        if name in seconds:
            continue
        folder = place.folder / name.replace(" ", "-")
        for earlier in (folder, pretraining_of(folder)):
            shutil.rmtree(earlier, ignore_errors=True)
        process = place.start(command(name, networks, folder), name, ROOT)
        seconds[name] = round(place.wait(process), 1)
        if process.wait() != 0:
            raise SystemExit(f"{name} must work undisturbed: {place.said(name)}")
    file.write_text(json.dumps(seconds))
    return networks, seconds


def command(name: str, networks: Path, folder: Path) -> list[str]:
    """The command line of one of the `RUNS`."""
    given = [f"pretrained={networks}"] if name.startswith("explore") else []
    if name == "explore from nothing":
        given = [f"pretraining.folder={pretraining_of(folder)}"]
    return [*RUNS[name], *given, f"hydra.run.dir={folder}"]
