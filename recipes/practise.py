"""Practise steering on the map of an exploration.

    python recipes/practise.py run=runs/explore/maze1-...
    python recipes/navigate.py run=runs/explore/maze1-... \
        navigator.practised=runs/practise/maze1-...

The agent walks to waypoints of its own map, which it draws at random, and learns from
how it comes along by its own belief about its pose: no position, no plan of the maze,
no goal and no reward of a task. What it learns corrects what steering in free space
says of each action: around corners, along walls, out of dead ends; and which edges of
the map it passed, how long they took, and which led nowhere. The run folder gets
``controller.pt``, ``edge_trials.pt``, ``practice.csv`` and ``practice.png`` while it
runs.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

from contextlib import closing
from pathlib import Path

import torch
from torchrl.collectors import Collector
from tqdm import tqdm

from toponav.builders import (
    load_exploration,
    make_controller,
    make_practice_env,
    save_controller,
    save_trials,
)
from toponav.config import PractiseConfig
from toponav.launch import recipe
from toponav.methods.navigators import make_practising_navigator
from toponav.reports import write_practice
from toponav.runs import stop_requests
from toponav.training import PracticeRules, SteeringPractice

#: What is true of a practice that was stopped: it has no ``resume``.
_STOPPED = "the run folder has the controller of the decisions so far"


@recipe("practise", aliases={"scale": "practise"})
def main(settings: PractiseConfig, folder: Path) -> None:
    """Load what was explored, walk, learn, and write the controller."""
    torch.set_num_threads(settings.threads or torch.get_num_threads())
    torch.manual_seed(settings.seed)

    # What the exploration left, and a controller that knows nothing yet.
    knowledge, _ = load_exploration(settings)
    sizes = knowledge.map.embeddings.shape[1], knowledge.world.num_actions
    controller = make_controller(*sizes)
    navigator = make_practising_navigator(settings, knowledge, controller)

    # It learns from batches of its own walks.
    practice = settings.practice
    names = PracticeRules.__dataclass_fields__
    rules = PracticeRules(**{name: getattr(practice, name) for name in names})
    learner = SteeringPractice(
        controller, temperature=navigator.rules.temperature, rules=rules
    )
    trials, rows = navigator.trials, list[dict[str, float]]()
    with (
        stop_requests(_STOPPED) as stop,
        closing(make_practice_env(settings)) as env,
        tqdm(total=practice.decisions, unit="decision", desc="practise") as bar,
    ):
        batches = Collector(
            env,
            navigator,
            frames_per_batch=practice.envs * practice.rollout,
            total_frames=practice.decisions,
            trust_policy=True,
        )
        for batch in batches:
            measured = learner.extend(batch)
            bar.update(batch.numel())
            bar.set_postfix({name: f"{measured[name]:.2f}" for name in measured})
            measured |= {
                "confirmed": float(trials.confirmed.any(1).float().mean()),
                "mistaken": float(trials.mistaken.float().mean()),
            }
            rows.append({"decisions": bar.n, **measured})
            write_practice(folder, rows)
            save_controller(controller, folder)
            save_trials(trials, folder)
            if stop.requested:
                break
    print(f"controller of {bar.n:,} decisions written to {folder}")
    found = (int(one.sum()) for one in (trials.confirmed.any(1), trials.mistaken))
    said = "of {:,} edges {:,} were passed, and {:,} are mistakes"
    print(said.format(len(trials.edges), *found))


if __name__ == "__main__":
    main()
