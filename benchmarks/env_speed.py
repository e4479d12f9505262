"""Speed of the batched environment, as ratios taken in one run.

    python benchmarks/env_speed.py --out results/env_speed.json

Rates are decisions per second (one decision is four engine tics and one view) with
random actions in each maze at 160x120, the median of several windows that take turns:

- bare: as many ``DoomGame`` as mazes, stepped in lock step by a thread pool with a
  thread each; the roof of anything that steps them together. Target for the
  environment: 0.7 of it with 8 mazes, 0.8 with 16.
- ``MazeEnv``: ``step_and_maybe_reset``, as collectors drive it.
- stock: ``ParallelEnv(8, GymEnv(...))`` of the maze. Target for the environment:
  at least 2.5 times its rate.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torchrl.envs import EnvBase, GymEnv, ParallelEnv

from toponav.envs import MAZES, MazeEnv, SceneRules, draw_scene, load_maze
from toponav.envs.engines.doom import (
    ACTIONS,
    TICS_PER_DECISION,
    WORLD,
    MazeGame,
)

BUTTONS = [list(buttons) for buttons in ACTIONS.values()]


def bare_stepper(
    maze: str, size: int
) -> tuple[Callable[[list[int]], object], Callable[[], None]]:
    """A lock-step pool over bare engines, and what ends it."""
    layout, cell_size = load_maze(maze), WORLD.motion.cell_size
    games = [MazeGame(layout) for _ in range(size)]
    generator = np.random.default_rng(0)
    for game in games:
        game.reset(draw_scene(layout, SceneRules(), generator, cell_size=cell_size))
    pool = ThreadPoolExecutor(size)

    def step_one(game: MazeGame, action: int) -> object:
        engine = game.engine.game
        engine.make_action(BUTTONS[action], TICS_PER_DECISION)
        return engine.get_state().screen_buffer

    def step(actions: list[int]) -> object:
        return list(pool.map(step_one, games, actions))

    def close() -> None:
        pool.shutdown()
        for game in games:
            game.close()

    return step, close


def env_stepper(env: EnvBase) -> Callable[[list[int]], object]:
    """Steps an environment as a collector does."""
    data = env.reset()

    def step(actions: list[int]) -> object:
        nonlocal data
        data["action"] = torch.tensor(actions)
        _, data = env.step_and_maybe_reset(data)
        return data

    return step


def stock_env(maze: str) -> EnvBase:
    """One Gymnasium maze in a worker of ``ParallelEnv``."""
    torch.set_num_threads(1)
    return GymEnv(f"toponav/{maze.title()}-v0", categorical_action_encoding=True)


def rates(
    steppers: dict[str, Callable[[list[int]], object]],
    size: int,
    *,
    windows: int,
    seconds: float,
) -> dict[str, list[float]]:
    """Decisions per second of each stepper in each window; they take turns."""
    actions = torch.randint(0, len(BUTTONS), (4096, size)).tolist()
    found: dict[str, list[float]] = {name: [] for name in steppers}
    for _ in range(windows):
        for name, step in steppers.items():
            start, count = time.perf_counter(), 0
            while time.perf_counter() - start < seconds:
                step(actions[count % len(actions)])
                count += 1
            found[name].append(count * size / (time.perf_counter() - start))
    return found


def compare(
    maze: str, size: int, *, with_stock: bool, windows: int, seconds: float
) -> dict[str, object]:
    """One table row: rates, and their ratios window by window."""
    bare, close_bare = bare_stepper(maze, size)
    env = MazeEnv(load_maze(maze), batch_size=size)
    steppers = {"bare": bare, "env": env_stepper(env)}
    make = partial(stock_env, maze)
    stock = ParallelEnv(size, make, mp_start_method="spawn") if with_stock else None
    if stock is not None:
        steppers["stock"] = env_stepper(stock)
    try:
        found = rates(steppers, size, windows=windows, seconds=seconds)
    finally:
        close_bare()
        env.close()
        if stock is not None:
            stock.close()
    row = {name: round(statistics.median(values)) for name, values in found.items()}
    for other in [name for name in found if name != "env"]:
        ratios = [a / b for a, b in zip(found["env"], found[other], strict=True)]
        row[f"env/{other}"] = round(statistics.median(ratios), 3)
        row[f"env/{other} range"] = [round(min(ratios), 3), round(max(ratios), 3)]
    return {"maze": maze, "mazes": size, **row, "load": round(os.getloadavg()[0], 2)}


def main() -> None:
    """Measure, print the table, keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mazes", nargs="+", choices=MAZES, default=[*MAZES][:3])
    parser.add_argument("--windows", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    run = partial(compare, windows=options.windows, seconds=options.seconds)
    rows = []
    for maze in options.mazes:
        for size, with_stock in ((8, True), (16, False)):
            rows.append(run(maze, size, with_stock=with_stock))
            print(rows[-1], flush=True)
    if options.out:
        options.out.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
