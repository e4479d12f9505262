"""Cost of an observation in a map of up to 10,000 waypoints.

    python benchmarks/map_growth.py --out results/map_growth.json

An observation is compared with the waypoints around the last one first. Only if none
of them is like it is the whole map searched, and then the network compares a shortlist
alone, so that what grows with the map is a distance to each waypoint, a thousand times
cheaper than a comparison. Beside it stands the paper's way, every observation against
every waypoint.

Maps of different sizes are square grids of places, and an observation's embedding tells
where it was made, so that a comparator fitted to that for a second knows what is near.
It has the shape of the small networks', which is what costs. Agents stay within the
map, as in a saturated exploration, or walk where it has no waypoints yet, so that it
grows with every few steps (``ground``: ``known`` or ``new``). All searches and sizes
are measured in turn in one run; the least processor time of several rounds counts, the
ratios are of those, and the load average says how far to trust them.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path

import torch
from tensordict import TensorDict
from torch import Tensor

from toponav.graph import MapRules, TopologicalMap
from toponav.modules import DifferenceComparator

DIM = 256
ENVS, DECISIONS = 4, 120
SEARCHES: dict[str, dict[str, int | None]] = {
    "neighbours first": {"nearby": 16, "shortlist": 32},
    "neighbours, then all": {"nearby": 16, "shortlist": None},
    "all": {"nearby": None, "shortlist": None},
}
#: Steps from the map to where agents walk, and the width of what is new there.
GROUNDS, WIDE = {"known": 0.0, "new": 500.0}, 20.0
#: Larger maps are left out of the paper's way: a batch would take minutes.
MOST_FOR_ALL = 4_000


def make_places(num: int, spacing: float) -> Tensor:
    """Points of a square grid with so many points, ``[num, 2]``."""
    side = round(num**0.5)
    row, column = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    return torch.stack([row, column], -1).reshape(-1, 2).float() * spacing


def make_embed(generator: torch.Generator) -> Callable[[Tensor], Tensor]:
    """Places to embeddings: waves of random directions and lengths."""
    waves = torch.randn(2, DIM, generator=generator) * 0.35
    phase = torch.rand(DIM, generator=generator) * 6.283

    def embed(places: Tensor) -> Tensor:
        return torch.cos(places @ waves + phase)

    return embed


def fit_comparator(
    embed: Callable[[Tensor], Tensor], generator: torch.Generator
) -> DifferenceComparator:
    """A comparator that scores two places above 0.9 if they are within 0.7."""
    torch.manual_seed(0)
    comparator = DifferenceComparator(DIM)
    optimizer = torch.optim.Adam(comparator.parameters(), lr=2e-3)
    for _ in range(300):
        here = torch.rand(512, 2, generator=generator) * 100
        away = torch.randn(512, 2, generator=generator)
        there = here + away * torch.rand(512, 1, generator=generator) * 3
        label = (3.0 * (1.4 - (here - there).norm(dim=-1))).sigmoid()
        logit = comparator(embed(here), embed(there))
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logit, label)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return comparator.eval()


def make_map(
    comparator: DifferenceComparator,
    places: Tensor,
    embed: Callable[[Tensor], Tensor],
    **searched: int | None,
) -> TopologicalMap:
    """A map with a waypoint at each place and edges to those beside it."""
    topological_map = TopologicalMap(
        lambda views: views.float(),
        lambda one, many: comparator.compare(one, many).sigmoid(),
        MapRules(
            tc_threshold=0.5,
            tc_reach=0.4,
            edges="time",
            **searched,  # type: ignore[arg-type]
        ),
        prepare=comparator.prepare,
    )
    embeddings, num = embed(places), len(places)
    side = round(num**0.5)
    number = torch.arange(num).reshape(side, side)
    across = torch.stack([number[:, :-1].flatten(), number[:, 1:].flatten()], 1)
    down = torch.stack([number[:-1].flatten(), number[1:].flatten()], 1)
    edges = torch.cat([across, down])
    topological_map.load_state_dict(
        {
            "embeddings": embeddings,
            "prepared": topological_map.waypoints.entries(embeddings),
            "images": torch.empty(0),
            "origins": torch.zeros(num, 2, dtype=torch.int64),
            "edges": edges,
            "traversals": torch.ones(len(edges), 2, dtype=torch.int64),
            "edge_similarity": torch.full((len(edges),), torch.nan),
            "version": 0,
            "network_version": 0,
            "tc_threshold": 0.5,
            "tc_reach": 0.4,
        }
    )
    return topological_map


def make_batch(
    embed: Callable[[Tensor], Tensor],
    limit: float,
    generator: torch.Generator,
    *,
    beyond: float = 0.0,
) -> TensorDict:
    """Random walks of a third of a step a decision that turn back at the map's ends.

    They are ``beyond`` the map, so many steps away.
    """
    turn = torch.randn(ENVS, DECISIONS, generator=generator).mul(0.3).cumsum(1)
    steps = torch.stack([turn.cos(), turn.sin()], -1) / 3
    start = torch.rand(ENVS, 1, 2, generator=generator) * limit
    place = (start + steps.cumsum(1)).remainder(2 * limit)
    place = limit - (place - limit).abs() + beyond
    done = torch.zeros(ENVS, DECISIONS, 1, dtype=torch.bool)
    done[:, -1] = True
    data = TensorDict({"embedding": embed(place)}, [ENVS, DECISIONS])
    data["next"] = TensorDict({"done": done}, [ENVS, DECISIONS])
    data["env_id"] = torch.arange(ENVS).reshape(-1, 1, 1).expand(ENVS, DECISIONS, 1)
    return data


@torch.no_grad()
def measure(sizes: list[int], rounds: int) -> list[dict[str, float | str]]:
    """Milliseconds of an observation, by search and size."""
    generator = torch.Generator().manual_seed(0)
    embed = make_embed(generator)
    with torch.enable_grad():
        comparator = fit_comparator(embed, generator)
    comparator.requires_grad_(False)
    best: dict[tuple[str, str, int], float] = {}
    num_new: dict[tuple[str, str, int], int] = {}
    for turn in range(rounds):
        for size in sizes:
            places = make_places(size, 0.8)
            limit, batches = 0.8 * (round(size**0.5) - 1), {}
            for ground, beyond in GROUNDS.items():
                seed = torch.Generator().manual_seed(turn)
                # Of one size, so that as many waypoints are found.
                wide = limit if ground == "known" else WIDE
                batches[ground] = make_batch(embed, wide, seed, beyond=beyond)
            for search, ground in product(SEARCHES, GROUNDS):
                if search == "all" and size > MOST_FOR_ALL:
                    continue
                settings, batch = SEARCHES[search], batches[ground]
                topological_map = make_map(comparator, places, embed, **settings)
                topological_map.graph.nearby(0, 16)
                start = time.process_time()
                new = topological_map.extend(batch)
                spent = (time.process_time() - start) / batch.numel()
                key = search, ground, len(places)
                best[key] = min(best.get(key, float("inf")), spent)
                num_new[key] = new
    return [
        {
            "search": search,
            "ground": ground,
            "waypoints": size,
            "ms_per_observation": 1e3 * seconds,
            "share_new_waypoints": num_new[search, ground, size] / (ENVS * DECISIONS),
        }
        for (search, ground, size), seconds in sorted(best.items())
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[100, 1024, 3136, 10000]
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = measure(arguments.sizes, arguments.rounds)
    costs = {
        (search, ground): {
            row["waypoints"]: row["ms_per_observation"]
            for row in rows
            if row["search"] == search and row["ground"] == ground
        }
        for search, ground in product(SEARCHES, GROUNDS)
    }
    growth = {
        f"{search}, {ground} ground": max(one.values()) / one[min(one)]
        for (search, ground), one in costs.items()
    }
    whole, first = costs["all", "known"], costs["neighbours first", "known"]
    largest = max(whole)
    found = {
        "rows": rows,
        "largest_over_smallest": growth,
        "all_over_neighbours_first_at": largest,
        "all_over_neighbours_first": whole[largest] / first[largest],
        "load": os.getloadavg()[0],
    }
    print(json.dumps(found, indent=2))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
