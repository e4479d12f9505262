"""`MapWriter`: the files and the picture of a map, written in a thread."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import torch
from matplotlib.figure import Figure
from torch import Tensor

from toponav.builders import (
    MAP_FILE,
    PLACES_FILE,
    POSES_FILE,
    mend_beside,
    name_contents,
    next_path,
    put_beside,
    save_places,
)
from toponav.graph import save_map
from toponav.metrics import map_parts
from toponav.plotting import draw_graph, save_figure
from toponav.runs import write_array, write_history
from toponav.training.episode_log import Row
from toponav.training.map_truth import MapTruth, Snapshot


class MapWriter:
    """Writes one map after the other, while the map grows.

    Args:
        name: of the world.
        truth: what judges the map, ``None`` in a world without ground truth.
    """

    def __init__(self, name: str, truth: MapTruth | None) -> None:
        self.name = name
        self.truth = truth
        #: Whether a map was not written, as another one was just being written.
        self.is_behind = False
        self._thread = ThreadPoolExecutor(1, "map")
        self._writing: Future[None] | None = None

    @property
    def is_writing(self) -> bool:
        """Whether the thread is at the last map."""
        return self._writing is not None and not self._writing.done()

    def wait(self) -> None:
        """Wait until all is written, and raise what went wrong with it."""
        if self._writing is not None:
            self._writing.result()
            self._writing = None

    def write(
        self, folder: Path, take: Callable[[], Snapshot], rows: list[Row]
    ) -> None:
        """Write the map that ``take`` gives, its poses, ``map.csv`` and its picture.

        A row that judges it is added to ``rows``, those of ``map.csv``. While the
        thread is at the last map, nothing is taken.
        """
        self.is_behind = self.is_writing
        if self.is_behind:
            return
        self.wait()
        self._writing = self._thread.submit(self._write, folder, take(), rows)

    def _write(self, folder: Path, now: Snapshot, rows: list[Row]) -> None:
        mend_beside(folder)
        row, edges, lengths = now.row, now.state["edges"], torch.empty(0)
        if self.truth is None:
            num = len(now.state["origins"])
            row |= {"waypoints": num, "edges": len(edges), **map_parts(num, edges)}
        else:
            lengths = self.truth.lengths(now)
            row |= self.truth.measure(now, lengths)
            write_array(next_path(folder / POSES_FILE), now.poses)
        if now.networks is not None:
            save_places(now.networks, next_path(folder / PLACES_FILE))
        rows.append(row)
        write_history(folder / "map.csv", rows)
        about = {"maze": self.name} | name_contents(folder)
        save_map(now.state, folder / MAP_FILE, about=about, views=now.views)
        put_beside(folder, about)
        save_figure(self._draw(now, lengths), folder / "topology.png", dpi=110)

    def _draw(self, now: Snapshot, lengths: Tensor) -> Figure:
        row = now.row
        parts = f"{row['components']} part{'s' if row['components'] != 1 else ''}"
        title = f"{self.name} after {row['decisions']:,} decisions: "
        if self.truth is not None:
            return self.truth.draw(now, lengths, title, parts)
        title += f"{row['waypoints']:,} waypoints, {row['edges']:,} edges, {parts}"
        num, edges = len(now.state["origins"]), now.state["edges"]
        return draw_graph(num, edges, now.cost, find_views=now.find_views, title=title)
