"""The map of an exploration: fed, judged, written, and taken up again."""

import copy
import csv
import errno
import math
import threading
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings, make_batch, world_of
from tests.graph.poses.ring_world import EFFECTS, compare, walk
from toponav import keys
from toponav.builders import PLACES_FILE, load_places, make_layout, make_networks
from toponav.builders.maps import make_map
from toponav.builders.pretraining import pretraining_decisions
from toponav.config import SettingsError
from toponav.config.explore import MOST_AROUND
from toponav.graph import PoseRules, ViewFile, load_map, save_map, walking_costs
from toponav.ground_truth import GroundTruthDistances, waypoint_poses
from toponav.metrics import map_quality
from toponav.training import MapGrowth, finish
from toponav.training.ground_training import GroundRules
from toponav.training.place_training import OffsetRules, PlaceRules

THRESHOLDS = {"reward_threshold": 0.5, "tc_threshold": 0.6, "tc_reach": 0.55}


def settings(*overrides):
    return explore_settings("map.tc_threshold=0.6", "map.tc_reach=0.55", *overrides)


def make_untrained_growth(config, folder=None, *, seed=0):
    torch.manual_seed(seed)
    world = world_of(config)
    networks = make_networks(config.model, world.spec)
    networks.modules.eval()
    networks.thresholds = dict(THRESHOLDS)
    return MapGrowth(config, world, networks, folder)


def make_growth(config, folder=None, *, seed=0):
    growth = make_untrained_growth(config, folder, seed=seed)
    # A comparison that tells random embeddings apart: how near they are.
    waypoints = growth.map.waypoints
    waypoints._compare = lambda one, many: torch.exp(
        -(one.unsqueeze(1) - many).square().mean(-1)
    )
    waypoints._prepare = None
    return growth


def make_walk(config, **arguments):
    """A batch whose agents stand in the middles of cells, each view with its pixels."""
    batch = make_batch(config, **arguments)
    cells = torch.as_tensor(make_layout(config.maze).open_mask).nonzero()
    rows = make_layout(config.maze).open_mask.shape[0]
    order = torch.arange(batch.numel()) % len(cells)
    row, column = cells[order].unbind(1)
    place = torch.stack([column + 0.5, rows - row - 0.5], 1) * 128
    batch[keys.POSITION] = place.reshape(*batch.shape, 2)
    batch[keys.NETWORK_PIXELS] = torch.zeros(*batch.shape, 60, 80, 3, dtype=torch.uint8)
    return batch


def test_each_waypoint_has_the_pose_of_its_view() -> None:
    config = settings()
    growth, seen = make_growth(config), {env: [] for env in range(4)}
    for start in (0, 32):
        batch = make_walk(config, start=start, seed=start)
        for env, places in zip(range(4), batch[keys.POSITION], strict=True):
            seen[env] += places.tolist()
        growth.extend(batch)
    assert growth.map.num_waypoints > 10
    assert len(growth.truth.poses.values) == growth.map.num_waypoints
    origins = growth.map.waypoints.origins.tolist()
    for (env, number), pose in zip(
        origins, growth.truth.poses.values.tolist(), strict=True
    ):
        assert pose[:2] == seen[env][number]


@pytest.mark.parametrize("name", ["window", "search_window", "surroundings"])
def test_a_view_may_wait_for_many_later_ones(name) -> None:
    # Each waits for three more batches.
    config = settings(f"map.{name}=100", "maze.episode_length=512")
    growth, seen = make_growth(config), {env: [] for env in range(4)}
    for start in range(0, 320, 32):
        batch = make_walk(config, start=start, seed=start)
        for env, places in zip(range(4), batch[keys.POSITION], strict=True):
            seen[env] += places.tolist()
        growth.extend(batch)
    origins = growth.map.waypoints.origins.tolist()
    assert len({env for env, _ in origins}) == 4
    assert max(number for _, number in origins) == 219
    for (env, number), pose in zip(
        origins, growth.truth.poses.values.tolist(), strict=True
    ):
        assert pose[:2] == seen[env][number]


def test_the_most_that_a_view_waits_for_is_remembered() -> None:
    assert waypoint_poses._BACK >= MOST_AROUND


def test_only_some_environments_feed_it_if_wanted() -> None:
    config = settings("map.envs=2")
    growth = make_growth(config)
    growth.extend(make_walk(config, envs=(3, 1, 2, 0)))
    assert set(growth.map.waypoints.origins[:, 0].tolist()) == {0, 1}
    before = growth.map.num_waypoints
    growth.extend(make_walk(config, envs=(2, 3)))
    assert growth.map.num_waypoints == before


def test_interaction_counts_all_until_every_cell_is_covered() -> None:
    # Without surroundings, a view is decided as soon as it has its votes.
    config = settings(
        "map.tc_threshold=0.999", "map.tc_reach=0.9", "map.surroundings=0"
    )
    growth = make_growth(config)
    num_cells = int(make_layout(config.maze).open_mask.sum())
    batch = make_walk(config)
    assert batch.numel() > num_cells
    growth.extend(batch[:1])
    assert math.isnan(growth.truth.decisions_to_cover)
    growth.extend(make_walk(config, start=32, seed=1))
    # 32 decisions of one environment, then 4 times 32.
    assert growth.truth.decisions_to_cover == 160
    growth.extend(make_walk(config, seed=3))
    assert growth.truth.decisions_to_cover == 160


def test_what_it_writes_can_be_read(tmp_path) -> None:
    config = settings()
    growth = make_growth(config)
    growth.extend(make_walk(config))
    growth.write(tmp_path)
    growth.finish(tmp_path)
    assert growth.rows[-1]["decisions"] == 128
    state, about = load_map(tmp_path / "map.zip")
    assert torch.equal(state["embeddings"], growth.map.embeddings)
    assert about["maze"] == config.maze.name
    poses = np.load(tmp_path / "map_poses.npy")
    assert (poses == growth.truth.poses.values.numpy()).all()
    with (tmp_path / "map.csv").open() as file:
        (entries,) = csv.DictReader(file)
    assert entries["waypoints"] == str(growth.map.num_waypoints)
    assert entries["decisions_to_cover"] == ""
    assert (tmp_path / "topology.png").stat().st_size > 5_000
    metric = GroundTruthDistances(
        torch.as_tensor(make_layout(config.maze).open_mask), cell_size=128.0
    )
    share = len(metric.cell_numbers(growth.truth.poses.values[:, :2]).unique())
    num_cells = int(make_layout(config.maze).open_mask.sum())
    assert float(entries["coverage"]) == pytest.approx(share / num_cells, abs=1e-5)


def test_another_goes_on_where_one_was_cut_off() -> None:
    config = settings()
    whole, cut = make_growth(config), make_growth(config)
    first, second = make_walk(config), make_walk(config, seed=1)
    # The second batch begins with new episodes, as after a restart.
    done = torch.zeros(4, 32, 1, dtype=torch.bool)
    done[:, -1] = True
    first["next", "done"] = done
    for growth in (whole, cut):
        growth.extend(first)
    resumed = make_growth(config)
    resumed.load_state_dict(cut.state_dict())
    for growth in (whole, resumed):
        growth.extend(second)
    one, other = whole.map.state_dict(), resumed.map.state_dict()
    for name in ("embeddings", "edges", "traversals"):
        assert torch.equal(one[name], other[name]), name
    assert torch.equal(whole.truth.poses.values, resumed.truth.poses.values)


def test_new_weights_are_taken_over_and_not_shared() -> None:
    config = settings("online.learn=true")
    growth = make_growth(config)
    growth.extend(make_walk(config))
    before = growth.map.embeddings.clone()
    with torch.no_grad():
        for parameter in growth.networks.tc.parameters():
            parameter.add_(0.1)
    again = growth.map.waypoints.embed(growth.map.waypoints.images)
    growth.refresh({"networks": 1})
    assert growth.map.network_version == 1
    assert not torch.equal(growth.map.embeddings, before)
    assert not torch.allclose(growth.map.embeddings, again)
    wanted = growth.networks.tc.embed(growth.map.waypoints.images[:1])
    assert torch.allclose(growth.map.embeddings[:1], wanted, atol=1e-5)


def test_what_changing_networks_make_of_views_is_in_no_checkpoint(tmp_path) -> None:
    config = settings("online.learn=true")
    growth = make_growth(config, tmp_path)
    growth.extend(make_walk(config))
    state = growth.state_dict()
    assert not {"embeddings", "prepared", "images"} & set(state["map"])
    # Of a waypoint: its origin (2 x 8 bytes), its pose (3 x 4), and where its view lies
    # in the file (2 x 8).
    kept = [state["map"][one] for one in ("origins", "headings", "positions", "views")]
    assert sum(one.nbytes for one in kept) == 44 * growth.map.num_waypoints
    # Other networks say what the views look like, as after they were published.
    resumed = make_growth(config, tmp_path, seed=1)
    before = growth.map.embeddings.clone()
    resumed.load_state_dict(state)
    growth.map.waypoints._embed = resumed.map.waypoints._embed
    growth.map.refresh(0)
    assert len(before) > 1
    assert not torch.equal(growth.map.embeddings, before)
    for name in ("embeddings", "prepared", "edges", "edge_cost"):
        assert torch.equal(getattr(resumed.map, name), getattr(growth.map, name)), name


def test_a_sparse_map_keeps_its_poses(tmp_path) -> None:
    config = settings("map.sparsify=1", "map.edges=both")
    growth = make_growth(config)
    growth.extend(make_walk(config))
    before = growth.map.num_waypoints
    poses = {tuple(pose) for pose in growth.truth.poses.values.tolist()}
    growth.map.set_thresholds(0.3, 0.2)
    growth.finish(tmp_path)
    assert 0 < growth.map.num_waypoints < before
    assert len(growth.truth.poses.values) == growth.map.num_waypoints
    assert {tuple(pose) for pose in growth.truth.poses.values.tolist()} <= poses
    assert (tmp_path / "map.zip").exists()


def test_thresholds_are_calibrated_or_given() -> None:
    config = explore_settings().map
    settings_ = explore_settings()
    world = world_of(settings_).spec
    tc = make_networks(settings_.model, world).tc.eval()
    found = make_map(config, tc, THRESHOLDS, world=world)
    assert (found.rules.tc_threshold, found.rules.tc_reach) == (0.6, 0.55)
    # A calibrated reach above the threshold is brought down to it.
    far = THRESHOLDS | {"tc_reach": 0.9}
    assert make_map(config, tc, far, world=world).rules.tc_reach == 0.6
    with pytest.raises(
        SettingsError, match="have no calibrated tc_threshold, got auto"
    ):
        make_map(config, tc, {}, world=world)
    high = explore_settings("map.tc_reach=0.9").map
    with pytest.raises(SettingsError, match=r"at most map.tc_threshold = 0.6, got"):
        make_map(high, tc, THRESHOLDS, world=world)


def test_decisions_of_all_earlier_runs_add_up(tmp_path) -> None:
    explored = "collect: {decisions: 7}\nreward: {}\nonline: {learn: true}"
    for name, entries in (
        ("first", "collect: {decisions: 1000}\ninit_from: null\n"),
        ("second", f"collect: {{decisions: 500}}\ninit_from: {tmp_path}/first\n"),
        ("explored", f"{explored}\npretrained: {tmp_path}/second\n"),
        ("unknown", f"{explored}\npretrained: null\n"),
    ):
        (tmp_path / name / "config").mkdir(parents=True)
        (tmp_path / name / "config" / "config.yaml").write_text(entries)
    given = explore_settings(f"pretrained={tmp_path}/second/networks.pt")
    assert pretraining_decisions(given) == 1500
    explored = explore_settings(f"pretrained={tmp_path}/explored")
    assert pretraining_decisions(explored) == 1507
    for name in ("unknown", "elsewhere"):
        given = explore_settings(f"pretrained={tmp_path}/{name}")
        assert math.isnan(pretraining_decisions(given))


def test_the_first_decisions_can_be_left_out() -> None:
    growth = make_growth(settings("map.after=128"))
    batch = make_walk(settings())
    growth.extend(batch)
    assert growth.map.num_waypoints == 0
    growth.extend(batch)
    growth.extend(batch)
    assert growth.map.num_waypoints > 0


def test_episodes_that_run_go_on_in_a_resumed_run() -> None:
    config = settings()
    whole, resumed = make_growth(config), make_growth(config)
    whole.extend(make_walk(config))
    # As in a checkpoint, nothing is shared.
    state, running = copy.deepcopy((whole.state_dict(), whole.running_episodes()))
    resumed.load_state_dict(state)
    resumed.resume_episodes(running)
    for growth in (whole, resumed):
        growth.extend(make_walk(config, start=32, seed=32))
    one, other = whole.map.state_dict(), resumed.map.state_dict()
    assert torch.equal(one["origins"], other["origins"])
    assert torch.equal(one["traversals"], other["traversals"])
    assert torch.equal(whole.truth.poses.values, resumed.truth.poses.values)


class SlowMap:
    """`save_map`, which waits until it may go on."""

    def __init__(self, monkeypatch) -> None:
        self.may_go, self.states = threading.Event(), []
        monkeypatch.setattr("toponav.training.map_writer.save_map", self)

    def __call__(self, state, path, **arguments) -> None:
        self.states.append(state)
        assert self.may_go.wait(20)
        save_map(state, path, **arguments)


def test_nobody_waits_for_the_map_but_the_end(tmp_path, monkeypatch) -> None:
    slow, growth = SlowMap(monkeypatch), make_growth(settings(), tmp_path)
    for seed in range(2):
        growth.extend(make_walk(settings(), seed=seed, start=32 * seed))
        growth.write(tmp_path)
        assert not (tmp_path / "map.zip").exists()
    assert len(slow.states) == 1
    slow.may_go.set()
    growth.finish(tmp_path)
    # The first writing missed the second batch.
    assert len(slow.states) == 2
    state, _ = load_map(tmp_path / "map.zip")
    assert len(state["origins"]) == growth.map.num_waypoints
    assert len(np.load(tmp_path / "map_poses.npy")) == growth.map.num_waypoints
    assert len(growth.rows) == 2


def test_a_resumed_run_writes_its_map_though_no_batch_comes(tmp_path) -> None:
    growth = make_growth(settings(), tmp_path)
    growth.extend(make_walk(settings()))
    growth.write(tmp_path)
    growth.writer.wait()
    before = growth.map.num_waypoints
    growth.extend(make_walk(settings(), seed=1, start=32))
    state = copy.deepcopy(growth.state_dict())
    # It was stopped after its last batch: the file is the map of the first one.
    resumed = make_growth(settings(), tmp_path)
    resumed.load_state_dict(state)
    resumed.finish(tmp_path)
    found, _ = load_map(tmp_path / "map.zip")
    assert len(found["origins"]) == growth.map.num_waypoints > before
    assert [row["decisions"] for row in resumed.rows] == [128, 256]


def test_a_map_that_cannot_be_written_is_said(tmp_path, monkeypatch) -> None:
    def fail(*args, **kwargs) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    growth = make_growth(settings(), tmp_path)
    growth.extend(make_walk(settings()))
    monkeypatch.setattr("toponav.training.map_writer.save_map", fail)
    growth.write(tmp_path)
    with pytest.raises(OSError, match="No space"):
        growth.finish(tmp_path)


def test_a_checkpoint_holds_no_views_and_the_next_run_has_them(tmp_path) -> None:
    growth = make_growth(settings(), tmp_path)
    growth.extend(make_walk(settings()))
    state = copy.deepcopy(growth.state_dict())
    kept = [value for value in state["map"].values() if torch.is_tensor(value)]
    assert all(value.dtype is not torch.uint8 for value in kept)
    views = growth.map.waypoints.images
    growth.extend(make_walk(settings(), seed=1, start=32))
    resumed = make_growth(settings(), tmp_path)
    resumed.load_state_dict(state)
    assert torch.equal(resumed.map.waypoints.images, views)
    assert len(views) > 10


def through_the_ring(config, growth, *, env, length=300):
    """Feed a walk through a small world, as a collector would; its true poses."""
    seen, poses = walk(env, length, seed=env)
    done = torch.zeros(1, length, 1, dtype=torch.bool)
    done[:, -1] = True
    batch = TensorDict({keys.EMBEDDING: seen.embeddings.float()[None]}, [1, length])
    batch[keys.ACTION] = seen.actions[None]
    batch[keys.ENV_ID] = torch.full((1, length, 1), env)
    batch[keys.IS_INIT] = torch.arange(length).reshape(1, -1, 1) == 0
    batch[keys.NETWORK_PIXELS] = torch.zeros(1, length, 4, 4, 3, dtype=torch.uint8)
    place, cell = poses[None, :, :2], growth.truth._metric.cell_size
    # Its 16 steps are put into the middle of one cell: the maze judges nothing here.
    batch[keys.POSITION] = 1.5 * cell + 0.01 * cell * (place - 8)
    batch[keys.HEADING] = poses[None, :, 2:]
    batch["next"] = TensorDict({keys.DONE: done, keys.REWARD: 0.0 * done}, [1, length])
    growth.extend(batch)


@pytest.fixture
def pose_growth(monkeypatch):
    learn_quickly(monkeypatch)
    return make_pose_growth


def learn_quickly(monkeypatch, *, rounds=4, updates=150):
    # Enough for a small world.
    quick = partial(PoseRules, rounds=rounds, updates=updates)
    monkeypatch.setattr("toponav.training.map_growth.PoseRules", quick)
    quick = partial(PlaceRules, updates=updates)
    monkeypatch.setattr("toponav.training.map_growth.PlaceRules", quick)
    quick = partial(OffsetRules, updates=updates)
    monkeypatch.setattr("toponav.training.map_growth.OffsetRules", quick)
    # How much is seen of the ground is tested beside the network that sees it.
    quick = partial(GroundRules, updates=20)
    monkeypatch.setattr("toponav.training.map_growth.GroundRules", quick)


def make_pose_growth(folder=None, *words):
    words = ("map.poses=true", "map.poses_above=0.1", "map.edges=time", *words)
    config = settings(*words)
    growth = make_growth(config, folder)
    growth.effects = EFFECTS
    waypoints = growth.map.waypoints
    waypoints._compare, waypoints._prepare = compare, None
    return config, growth


def test_poses_leave_few_waypoints_at_the_end(
    tmp_path, pose_growth, monkeypatch
) -> None:
    config, growth = pose_growth(tmp_path)
    assert keys.ACTION in growth.in_keys
    # Nothing that is read, but for what judges the map, says where the agent is.
    judged = {keys.POSITION, keys.HEADING}
    assert not any("privileged" in key for key in set(growth.in_keys) - judged)
    for env in range(3):
        through_the_ring(config, growth, env=env)
    many, planned = growth.map.num_waypoints, []

    def judge(metric, poses, edges, cost, **given):
        planned.append(cost)
        return map_quality(metric, poses, edges, cost, **given)

    monkeypatch.setattr("toponav.training.map_truth.map_quality", judge)
    shares: list[float] = []
    finish({"map": growth}, tmp_path, beside=True, progress=shares.append)
    # It goes on all the time: poses, then three networks.
    assert shares == sorted(shares)
    assert shares[-1] == 1
    steps = [later - one for one, later in pairwise([0.0, *shares])]
    assert max(steps) < 0.06
    number = growth.map.num_waypoints
    assert 10 < number < many / 2
    assert len(growth.truth.poses.values) == number == growth.growth[-1][1]
    assert growth.rows[-1]["waypoints"] == number
    # Paths are planned by steps, as an agent plans that knows poses.
    waypoints, graph = growth.map.waypoints, growth.map.graph
    cost = walking_costs(waypoints.positions, graph.edges, graph.traversals)
    torch.testing.assert_close(planned[-1], cost)
    state, _ = load_map(tmp_path / "map.zip")
    assert len(state["images"]) == number
    assert np.load(tmp_path / "map_poses.npy").shape == (number, 3)
    # The file has the poses, and beside it is what knows its waypoints by their views.
    assert torch.equal(state["positions"], growth.map.waypoints.positions)
    assert state["positions"].isfinite().all()
    path, embeddings = tmp_path / PLACES_FILE, growth.map.embeddings
    sizes = {"num_places": number, "embedding_size": embeddings.shape[1]}
    networks = load_places(path, **sizes, setting="run")
    with torch.no_grad():
        found = networks.places(embeddings).argmax(1)
        offsets = networks.offsets(embeddings)
    away = growth.map.waypoints.positions[found] - growth.map.waypoints.positions
    assert away.norm(dim=1).median() < 3
    # From the nearest other waypoint, an offset leads nearer to where each is.
    own = growth.map.waypoints.positions
    apart = torch.cdist(own, own).fill_diagonal_(torch.inf)
    beside = apart.argmin(1)
    said = own[beside] + offsets[torch.arange(number), beside, :2]
    assert (said - own).norm(dim=1).median() < 0.9 * apart.amin(1).median()
    for name in ("offsets", "ground"):
        loaded, trained = getattr(networks, name), getattr(growth.map_networks, name)
        assert torch.equal(loaded(embeddings), trained(embeddings))


def test_a_resumed_run_has_the_walks_of_the_map(pose_growth) -> None:
    config, whole = pose_growth()
    _, half = pose_growth()
    for env in range(2):
        through_the_ring(config, whole, env=env)
    through_the_ring(config, half, env=0)
    _, resumed = pose_growth()
    resumed.load_state_dict(half.state_dict())
    through_the_ring(config, resumed, env=1)
    whole.consolidate()
    resumed.consolidate()
    assert torch.equal(resumed.map.embeddings, whole.map.embeddings)
    assert torch.equal(resumed.map.edges, whole.map.edges)


def test_no_walks_are_kept_where_poses_are_not_wanted_or_not_possible() -> None:
    assert make_growth(settings("map.poses=false")).map.walks is None
    online = settings("map.poses=true", "online.learn=true")
    assert make_growth(online).map.walks is None


def test_a_map_whose_poses_do_not_fit_is_said_to_stay(pose_growth, capsys) -> None:
    _, growth = pose_growth()
    growth.effects = EFFECTS
    # Two walks whose views have nothing in common.
    waypoints = growth.map.waypoints
    waypoints._compare = lambda one, many: torch.zeros(many.shape[:2])
    for env in range(2):
        through_the_ring(None, growth, env=env, length=60)
    before = growth.map.num_waypoints
    assert growth.consolidate() is None
    assert growth.map.num_waypoints == before == growth.growth[-1][1]
    assert "map: as it grew" in "".join(capsys.readouterr())


def test_a_waypoint_of_the_papers_network_takes_at_most_8_kb(tmp_path) -> None:
    # Embedding and what is compared: 512 numbers of four bytes each, and some counts.
    config = settings("model=resnet18", "model.embedding_dim=512", "map.envs=null")
    waypoints = make_untrained_growth(config, tmp_path).map.waypoints
    # The view, 58 kB, is not in memory.
    assert isinstance(waypoints.views, ViewFile)
    embeddings = torch.randn(10, 512)
    held = embeddings.nbytes + waypoints.entries_of(embeddings).nbytes
    assert 10 * 4096 <= held <= 10 * 8000
