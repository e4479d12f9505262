r"""What writing a map costs an exploration: seconds, waits of the learner, bytes.

    PYTHONPATH=. python benchmarks/map_writing.py --out results/map_writing.json

A map of ``scale=paper`` (two times 512 numbers and a view a waypoint) lies
over the plan of maze3, with about five edges a waypoint and views of random walks. It
is written as in an exploration: the caller takes a snapshot, and a thread judges the
map, writes its files and draws it. Meanwhile the caller does what stands for a learner,
steps of Adam: on a network as small as a policy's, which are many short operations, and
on a large one. *Waits* is the time of the call and by how much the steps took longer
than the median one alone, *longest* the longest of these. Then a checkpoint is written,
for which the learner waits altogether; the views are in ``map_views.bin``, to which it
refers. Before each of them the map changes, as it does between two of them.

The parts of the writing are also made alone, and a picture of the same map where there
is no plan, in processor seconds. All are medians of some rounds; the load average says
how far to trust those that are not of the processor.
"""

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import torch
from explore_speed import compose_settings
from torch import Tensor, nn

from tests.graph.maze_map import MazeMap, make_maze_map
from toponav.builders import MAP_FILE, make_networks, prepare_process
from toponav.envs import MazeEnv, load_maze
from toponav.graph import save_map
from toponav.ground_truth import WaypointPoses
from toponav.methods import make_world
from toponav.plotting import draw_graph, save_figure
from toponav.runs import CHECKPOINT_FILE
from toponav.training import ExplorationState, MapGrowth, save_exploration

MAZE, MAZES, STEPS = "maze3", 2, 256
#: Width and batch of what stands for a learner: a step takes some milliseconds, and
#: some hundredths of a second.
LEARNERS = {"small": (256, 64), "large": (1_024, 512)}
#: Views that a waypoint stands for, in the mean.
VIEWS_OF_ONE = 20
THRESHOLDS = {"reward_threshold": 0.5, "tc_threshold": 0.6, "tc_reach": 0.55}


def walked_views() -> list[Tensor]:
    """What random walks see, uint8 ``[H, W, 3]`` each."""
    env = MazeEnv(load_maze(MAZE), batch_size=MAZES, seed=0)
    try:
        pixels = env.rollout(STEPS, break_when_any_done=False)["pixels"]
    finally:
        env.close()
    return list(pixels.flatten(0, 1))


def grow(made: MazeMap, views: Iterator[Tensor], folder: Path) -> MapGrowth:
    """The growth of an exploration whose map is the one that was ``made``."""
    settings = compose_settings("explore", ["scale=paper", f"maze={MAZE}"])
    world = make_world(settings)
    networks = make_networks(settings.model, world.spec)
    networks.modules.eval()
    networks.thresholds = dict(THRESHOLDS)
    growth = MapGrowth(settings, world, networks, folder)
    found, num = growth.map, len(made.poses)
    for view in islice(views, num):
        found.waypoints.views.append(view)
    embeddings = torch.randn(num, settings.model.embedding_dim)
    found.load_state_dict(
        {
            "embeddings": embeddings,
            "prepared": found.waypoints.entries_of(embeddings),
            "origins": torch.arange(num).unsqueeze(1).repeat(1, 2),
            "edges": made.edges,
            "traversals": (made.cost == 1).long().unsqueeze(1).repeat(1, 2),
            "edge_similarity": torch.rand(len(made.edges)),
            "version": 0,
            "network_version": 0,
            "tc_threshold": THRESHOLDS["tc_threshold"],
            "tc_reach": THRESHOLDS["tc_reach"],
            **found.waypoints.views.state_dict(),
        }
    )
    assert growth.truth is not None
    growth.truth.poses = WaypointPoses(made.poses)
    growth.decisions = VIEWS_OF_ONE * num
    growth.growth.append((growth.decisions, num))
    return growth


def make_step(width: int, batch_size: int) -> Callable[[], None]:
    """What stands for a learner: a step of Adam."""
    network = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 6))
    optimizer = torch.optim.Adam(network.parameters())
    batch = torch.randn(batch_size, width)

    def step() -> None:
        optimizer.zero_grad()
        network(batch).square().mean().backward()
        optimizer.step()

    return step


def timed(call: Callable[[], object]) -> float:
    """Seconds of a call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def write_beside(
    growth: MapGrowth, folder: Path, step: Callable[[], None]
) -> dict[str, float]:
    """Seconds of writing the map while a learner learns, and what that costs it."""
    alone = statistics.median(timed(step) for _ in range(100))
    start, spent = time.perf_counter(), time.process_time() - time.thread_time()
    call, steps = timed(lambda: growth.write(folder)), []
    while growth.writer.is_writing:
        steps.append(timed(step))
    growth.writer.wait()
    return {
        "write_s": time.perf_counter() - start,
        "write_processor_s": time.process_time() - time.thread_time() - spent,
        "call_s": call,
        "waits_s": call + sum(steps) - alone * len(steps),
        "longest_s": max([call, *(one - alone for one in steps)]),
        "step_alone_s": alone,
    }


def time_parts(growth: MapGrowth, folder: Path) -> dict[str, float]:
    """Processor seconds of each part of the writing, one after the other."""
    parts, truth = dict[str, float](), growth.truth
    assert truth is not None

    @contextmanager
    def part(name: str) -> Iterator[None]:
        start = time.process_time()
        yield
        parts[name] = time.process_time() - start

    with part("snapshot"):
        now = growth.snapshot()
    with part("judge"):
        lengths = truth.lengths(now)
        now.row.update(truth.measure(now, lengths))
    with part("file"):
        save_map(now.state, folder / MAP_FILE, views=now.views)
    with part("picture"):
        figure = truth.draw(now, lengths, MAZE, "1 part")
        save_figure(figure, folder / "topology.png", dpi=110)
    with part("picture_without_plan"):
        given = len(now.poses), now.state["edges"], now.cost
        figure = draw_graph(*given, find_views=now.find_views)
        save_figure(figure, folder / "graph.png", dpi=110)
    return parts


def measure(num: int, views: list[Tensor], rounds: int) -> dict[str, object]:
    """All that is measured of a map of so many waypoints."""
    made, written = make_maze_map(num, maze=MAZE), dict[str, list[dict[str, float]]]()
    steps = {name: make_step(*sizes) for name, sizes in LEARNERS.items()}
    parts, saved = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        growth = grow(made, cycle(views), folder)
        one, other = made.edges[0].tolist()
        for _ in range(rounds):
            for learner, step in steps.items():
                growth.map.graph.traverse(one, other)
                found = write_beside(growth, folder, step)
                written.setdefault(learner, []).append(found)
            growth.map.graph.traverse(one, other)
            parts.append(time_parts(growth, folder))
            growth.map.graph.traverse(one, other)
            state = ExplorationState(decisions=growth.decisions)
            saved.append(
                timed(partial(save_exploration, folder, state, {"map": growth}))
            )
        files = (MAP_FILE, "topology.png", CHECKPOINT_FILE, "map_views.bin")
        bytes_of = {file: (folder / file).stat().st_size for file in files}
    return {
        "waypoints": num,
        "edges": len(made.edges),
        "beside_a_learner": {name: medians(rows) for name, rows in written.items()},
        "checkpoint_s": statistics.median(saved),
        "parts_processor_s": medians(parts),
        "bytes": bytes_of,
    }


def medians(rows: list[dict[str, float]]) -> dict[str, float]:
    """The median of each column."""
    return {name: statistics.median(row[name] for row in rows) for name in rows[0]}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    prepare_process(threads=1, seed=0)
    views = walked_views()
    found = {
        "maps": [measure(num, views, options.rounds) for num in options.sizes],
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=2))
    if options.out is not None:
        options.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
