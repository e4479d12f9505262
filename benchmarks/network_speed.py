"""Speed of the networks, as ratios taken in one run.

    python benchmarks/network_speed.py --threads 1 2 --out results/network_speed.json

Three ratios, each beside the load average of the machine:

- embed: ResNet-18 in bfloat16 on uint8 views, its FLOP per second over
  those of a large bfloat16 matrix product (the roof). Target 0.85.
- compare: one view of each of 8 environments against 200 prepared waypoints, the FLOP
  of the split form over the same roof. Target 0.7.
- mine: training pairs per second from 32 views in chunks, over those from 64 separate
  pairs of 128 views. Target 3.5, even if only 64 of the mined pairs are counted.

Every time is the best of several short windows, and the two sides of a ratio take
turns, so that a busy machine spoils both alike.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor

from toponav.data import Chunks, Episodes, TCPairs
from toponav.envs import DEFAULT_ENGINE, load_engine
from toponav.modules import ConcatComparator, ResNet18, SmallEncoder, TCNetwork
from toponav.objectives import TCLoss

RESNET_FLOP = 1.430e9
SPLIT_FLOP = 2 * (3 * 512 * 512 + 512)
NUM_ENVS, NUM_WAYPOINTS = 8, 200
ROOF_SIZE = 2048
SEPARATE_PAIRS = 64


@dataclass
class Row:
    """One line of the table."""

    what: str
    threads: int
    rate: float
    unit: str
    against: float
    ratio: float
    target: float
    load: float


def best_seconds(*calls: Callable[[], object], windows: int) -> list[float]:
    """The shortest time of each call; the calls take turns."""
    best = [float("inf")] * len(calls)
    for call in calls:
        call()
    for _ in range(windows):
        for index, call in enumerate(calls):
            start = time.perf_counter()
            call()
            best[index] = min(best[index], time.perf_counter() - start)
    return best


#: Height and width of a view in pixels.
VIEW = load_engine(DEFAULT_ENGINE).world.view_size


def make_views(*batch: int) -> Tensor:
    """Random views as the environment yields them."""
    return torch.randint(0, 256, (*batch, *VIEW, 3), dtype=torch.uint8)


def make_roof() -> Callable[[], object]:
    """A matrix product that the machine is best at."""
    a, b = torch.randn(2, ROOF_SIZE, ROOF_SIZE).bfloat16()
    return lambda: a @ b


def measure_embed(batch: int, threads: int, windows: int) -> Row:
    """ResNet-18 against the roof."""
    encoder, views = ResNet18(image_size=VIEW).eval().bfloat16(), make_views(batch)
    seconds, roof = best_seconds(lambda: encoder(views), make_roof(), windows=windows)
    rate, limit = batch / seconds, 2 * ROOF_SIZE**3 / roof
    return Row(
        f"embed, batch {batch}",
        threads,
        rate,
        "views/s",
        limit / RESNET_FLOP,
        rate * RESNET_FLOP / limit,
        0.85,
        os.getloadavg()[0],
    )


def measure_compare(threads: int, windows: int) -> Row:
    """The comparator on a prepared memory against the roof."""
    comparator = ConcatComparator(512).eval().bfloat16()
    embedding = torch.randn(NUM_ENVS, 512).bfloat16()
    memory = torch.randn(NUM_ENVS, NUM_WAYPOINTS, 512).bfloat16()
    prepared = comparator.prepare(memory)
    seconds, roof = best_seconds(
        lambda: comparator.compare(embedding, prepared),
        make_roof(),
        windows=4 * windows,
    )
    rate, limit = NUM_ENVS * NUM_WAYPOINTS / seconds, 2 * ROOF_SIZE**3 / roof
    return Row(
        f"compare, {NUM_ENVS} x {NUM_WAYPOINTS}",
        threads,
        rate,
        "pairs/s",
        limit / SPLIT_FLOP,
        rate * SPLIT_FLOP / limit,
        0.7,
        os.getloadavg()[0],
    )


class MineBench:
    """Training steps on separate and on mined pairs, with one network and optimizer."""

    def __init__(self, encoder: ResNet18 | SmallEncoder) -> None:
        comparator = ConcatComparator(encoder.embedding_dim)
        self.network = TCNetwork(encoder, comparator).train()
        keys = {"in_keys": ["anchor", "other"], "out_keys": ["logit"]}
        self.loss_on_views = TCLoss(TensorDictModule(self.network, **keys))
        self.loss_on_embeddings = TCLoss(TensorDictModule(comparator, **keys))
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=1e-4)
        self.separate = TensorDict(
            {
                "anchor": make_views(SEPARATE_PAIRS),
                "other": make_views(SEPARATE_PAIRS),
                "label": torch.tensor([0.0, 1.0]).repeat(SEPARATE_PAIRS // 2),
            },
            [SEPARATE_PAIRS],
        )
        # 32 views: two chunks of 8 from each of two episodes.
        self.rule, chunks = TCPairs(), Chunks(chunks_per_episode=2, chunk_len=8)
        self.generator = torch.Generator().manual_seed(0)
        episodes = Episodes.from_lengths([1800] * 50)
        _, extra = chunks.draw(episodes, 32, self.generator)
        self.frames = TensorDict({**extra, "pixels": make_views(2, 16)}, [2, 16])
        self.frames["embedding"] = self.frames["step"]
        self.num_mined = len(self.rule.mine(self.frames))

    def step_on_separate(self) -> None:
        """One update from 64 pairs of views of their own."""
        with torch.enable_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
            loss = self.loss_on_views(self.separate)["loss_tc"]
        self._update(loss)

    def step_on_mined(self) -> None:
        """One update from all pairs among 32 views."""
        with torch.enable_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
            self.frames["embedding"] = self.network.embed(self.frames["pixels"])
            pairs = self.rule.mine(self.frames, generator=self.generator)
            loss = self.loss_on_embeddings(pairs)["loss_tc"]
        self._update(loss)

    def _update(self, loss: Tensor) -> None:
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()


def measure_mine(
    encoder: ResNet18 | SmallEncoder, threads: int, windows: int
) -> list[Row]:
    """Mined against separate pairs: as many as there are, and only 64 counted."""
    bench = MineBench(encoder)
    slow, fast = best_seconds(
        bench.step_on_separate, bench.step_on_mined, windows=windows
    )
    against = SEPARATE_PAIRS / slow
    return [
        Row(
            f"mine, {type(encoder).__name__}, {counted} pairs",
            threads,
            counted / fast,
            "pairs/s",
            against,
            counted / fast / against,
            3.5,
            os.getloadavg()[0],
        )
        for counted in (bench.num_mined, SEPARATE_PAIRS)
    ]


def measure_all(threads: int, batches: list[int], windows: int) -> Iterator[Row]:
    """All rows for one number of threads."""
    torch.set_num_threads(threads)
    for batch in batches:
        yield measure_embed(batch, threads, windows)
    yield measure_compare(threads, windows)
    yield from measure_mine(ResNet18(image_size=VIEW), threads, max(windows // 4, 2))
    yield from measure_mine(SmallEncoder(image_size=VIEW), threads, windows)


@torch.no_grad()
def main() -> None:
    """Measure, print a table, and write it if asked."""
    parser = argparse.ArgumentParser(description="Speed of the networks, as ratios.")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--batch", type=int, nargs="+", default=[8, 16, 32])
    parser.add_argument("--windows", type=int, default=12, help="tries per figure")
    parser.add_argument("--out", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    print(f"{'what':32} threads {'rate':>21} {'against':>10}  ratio target  load")
    rows = []
    for threads in arguments.threads:
        for row in measure_all(threads, arguments.batch, arguments.windows):
            rows.append(asdict(row))
            print(
                f"{row.what:32} {row.threads:7d} {row.rate:13.1f} {row.unit:>7}"
                f" {row.against:10.1f} {row.ratio:6.2f} {row.target:6.2f}"
                f" {row.load:5.2f}",
                flush=True,
            )
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
