"""The package's mazes, and random ones."""

import networkx as nx
import pytest
from hypothesis import given, settings, strategies as st

from tests.envs.layouts import steps_from
from toponav.envs import MAZES, Layout, load_maze, make_random_layout

# The middle cells of the south wall's and of the north wall's box.
MAZE1_START, MAZE1_GOAL = (12, 4), (1, 4)


@pytest.mark.parametrize(
    ("name", "num_cells", "slots"),
    [
        ("maze1", 51, {"a": (8, 4), "b": (4, 4)}),
        ("maze2", 41, {}),
        ("maze3", 63, {}),
        ("select", 49, {}),
    ],
)
def test_mazes_are_those_of_the_notes(
    name: str, num_cells: int, slots: dict[str, tuple[int, int]]
) -> None:
    layout = load_maze(name)
    assert layout.name == name
    assert layout.num_cells == num_cells
    assert dict(layout.slots) == slots


def test_every_maze_is_listed() -> None:
    assert MAZES == ("maze1", "maze2", "maze3", "select")


@pytest.mark.parametrize(
    ("name", "loops"), [("maze1", 6), ("maze2", 0), ("maze3", 4), ("select", 6)]
)
def test_mazes_have_the_loops_of_the_notes(name: str, loops: int) -> None:
    # Independent loops of a connected graph: edges - nodes + 1.
    graph = load_maze(name).graph()
    assert graph.number_of_edges() - graph.number_of_nodes() + 1 == loops


@pytest.mark.parametrize(
    ("closed", "length"), [("", 11), ("a", 17), ("b", 27), ("ab", 27)]
)
def test_maze1_has_paths_of_three_lengths(closed: str, length: int) -> None:
    steps = steps_from(load_maze("maze1"), MAZE1_START, closed)
    assert steps[MAZE1_GOAL] == length


@pytest.mark.parametrize(
    ("name", "near"), [("maze4", "maze[123]"), ("Select", "select"), ("", "select")]
)
def test_a_wrong_name_is_refused_with_the_nearest(name: str, near: str) -> None:
    with pytest.raises(ValueError, match=rf"got '{name}' \(did you mean '{near}'\?\)"):
        load_maze(name)


class TestRandomLayouts:
    @settings(max_examples=60, deadline=None)
    @given(
        rows=st.integers(1, 12),
        cols=st.integers(1, 12),
        seed=st.integers(0, 2**63),
        loops=st.floats(0, 1),
    )
    def test_have_the_asked_size_and_loops(
        self, rows: int, cols: int, seed: int, loops: float
    ) -> None:
        layout = make_random_layout(rows, cols, seed=seed, loops=loops)
        assert layout.shape == (2 * rows + 1, 2 * cols + 1)
        # Junctions, one edge cell each for the tree, one each for the loops.
        walls = rows * (cols - 1) + cols * (rows - 1) - (rows * cols - 1)
        opened = round(loops * walls)
        assert layout.num_cells == 2 * rows * cols - 1 + opened
        graph = layout.graph()
        assert nx.is_connected(graph)
        assert graph.number_of_edges() - graph.number_of_nodes() + 1 == opened

    def test_are_the_seeds_function(self) -> None:
        layouts = {make_random_layout(6, 7, seed=seed).text for seed in range(20)}
        assert len(layouts) == 20
        assert make_random_layout(6, 7, seed=3) == make_random_layout(6, 7, seed=3)

    def test_go_to_the_largest_size(self) -> None:
        layout = make_random_layout(50, 50, seed=0)
        assert layout.shape == (101, 101)
        assert isinstance(layout, Layout)

    @pytest.mark.parametrize(
        ("rows", "cols", "loops", "message"),
        [
            (0, 5, 0.1, "rows must be between 1 and 50, got 0"),
            (5, 51, 0.1, "cols must be between 1 and 50, got 51"),
            (5, 5, -0.1, r"loops must lie in \[0, 1\], got -0.1"),
            (5, 5, float("nan"), r"loops must lie in \[0, 1\], got nan"),
        ],
    )
    def test_refuse_sizes_out_of_range(
        self, rows: int, cols: int, loops: float, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            make_random_layout(rows, cols, seed=0, loops=loops)
