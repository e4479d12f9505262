"""`WaypointPoses`: the truth about a map, batch by batch."""

import pytest
import torch
from tensordict import TensorDict

from tests.refused import refused
from toponav.ground_truth import WaypointPoses


def batch(start, length, envs=(0,)):
    """Environment e stands at x = number of the observation, y = e."""
    x = torch.arange(start, start + length).float().expand(len(envs), -1)
    y = torch.tensor(envs).float().unsqueeze(1).expand(-1, length)
    pose = {"position": torch.stack([x, y], -1), "heading": x.unsqueeze(-1) % 360}
    number = torch.tensor(envs).reshape(-1, 1, 1).expand(len(envs), length, 1)
    return TensorDict({"privileged": pose, "env_id": number}, [len(envs), length])


def test_poses_are_found_many_batches_later() -> None:
    poses = WaypointPoses()
    for start in range(0, 300, 60):
        poses.remember(batch(start, 60, (7, 2)))
    origins = torch.tensor([[2, 299], [7, 240], [2, 200]])
    poses.extend(origins)
    assert poses.values[:, :2].tolist() == [[299, 2], [240, 7], [200, 2]]
    # Those that are known are not looked up again, however long ago they were.
    for start in range(300, 600, 60):
        poses.remember(batch(start, 60, (7, 2)))
    poses.extend(torch.cat([origins, torch.tensor([[7, 560]])]))
    assert poses.values[3].tolist() == [560, 7, 200]


def test_what_was_not_remembered_is_an_error() -> None:
    poses = WaypointPoses()
    for start in range(0, 18_000, 6000):
        poses.remember(batch(start, 6000))
    # 8192 before the last batch are kept.
    for number in (3000, 18_000):
        with pytest.raises(KeyError, match=f"observation {number} of environment 0"):
            poses.extend(torch.tensor([[0, number]]))


def test_after_a_merge_the_first_of_each_is_where_it_is() -> None:
    poses = WaypointPoses(torch.arange(12.0).reshape(4, 3))
    poses.merge(torch.tensor([0, 1, 0, 1]))
    assert poses.values.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_a_map_without_waypoints_has_nothing_to_merge() -> None:
    poses = WaypointPoses()
    poses.merge(torch.empty(0, dtype=torch.int64))
    assert poses.values.shape == (0, 3)


def test_a_batch_without_positions_is_refused_in_words() -> None:
    said = refused(lambda: WaypointPoses().remember(TensorDict(batch_size=[2, 3])))
    assert "position" in said
