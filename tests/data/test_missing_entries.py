"""Training data that lack an entry or a part say so."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from tests.refused import Parts, embed, refused
from toponav import data, keys


def frames(*left_out: str) -> TensorDict:
    """Two episodes of frames, but for some entries."""
    found = TensorDict(
        {
            keys.NETWORK_PIXELS: torch.zeros(2, 30, 4, 4, 3, dtype=torch.uint8),
            keys.ACTION: torch.zeros(2, 30).long(),
            "step_count": torch.arange(30).expand(2, 30),
            keys.TRAJECTORY: torch.arange(2).unsqueeze(1).expand(2, 30),
        },
        [2, 30],
    )
    return found.exclude(*left_out)


def replay_batch() -> TensorDict:
    flag = torch.zeros(2, 3, 1, dtype=torch.bool)
    now = {"pixels": torch.zeros(2, 3, 4), "action": torch.zeros(2, 3), "is_init": flag}
    later = {"pixels": torch.zeros(2, 3, 4), "reward": torch.zeros(2, 3, 1)}
    following = {**later, "done": flag, "terminated": flag}
    return TensorDict({**now, "next": following}, [2, 3])


def mined(*left_out: str, **given: object) -> data.MinedPairs:
    options = {"embed_tc": embed, "num_frames": 40, **given}
    return data.MinedPairs(frames(*left_out), **options)  # type: ignore[arg-type]


PARTS: Parts = {
    "rule of a sampler": (
        lambda: data.EpisodeSampler(4),
        "rule must be such as TCPairs, LPairs or Chunks, got int without draw",
    ),
    "embed of pairs": (
        lambda: mined(embed_tc="resnet18"),
        "embed_tc must be a function or a network, got str",
    ),
    "rule of pairs": (
        lambda: mined(tc_pairs=data.Chunks()),
        "tc_pairs must be such as TCPairs or LPairs, got Chunks without mine",
    ),
    "storage of pairs": (
        lambda: data.MinedPairs([], embed_tc=embed),
        "storage must be such as frames or a Storage, got list without get, ndim",
    ),
    "rule of held-out pairs": (
        lambda: data.HeldOut(frames(), name="maze1").draw(4, 10, seed=0),
        "rule must be such as TCPairs or LPairs, got int without draw",
    ),
}


def test_the_training_data_name_what_is_missing() -> None:
    mined()()
    assert "'network_pixels'" in refused(mined("network_pixels"))
    assert "'action'" in refused(mined("action"))
    assert "step_count" in refused(mined("step_count"))
    drawn = partial(data.DrawnPairs, num_pairs=4)
    assert "'network_pixels'" in refused(drawn(frames("network_pixels")))
    split = data.SplitPairs()
    assert "'network_pixels'" in refused(lambda: split(TensorDict(batch_size=[3, 2])))
    held_out = data.HeldOut(TensorDict(batch_size=[2, 30]), name="maze1")
    assert "'network_pixels'" in refused(lambda: held_out.pixels)
    draw = partial(held_out.draw, data.LPairs(2), 4, seed=0)
    assert "'action'" in refused(draw)


def test_the_replay_names_each_entry_that_is_missing() -> None:
    make = partial(data.SliceReplay, 64, length=2, view="pixels", reward="reward")
    make().extend(replay_batch())
    for key in make().in_keys:
        said = refused(lambda key=key: make().extend(replay_batch().exclude(key)))
        assert repr(key) in said
    assert "rows" not in refused(lambda: make().sample(3))
    assert "[E, T]" in refused(lambda: make().extend(replay_batch()[0]))


@pytest.mark.parametrize("case", PARTS)
def test_a_part_that_lacks_something_is_named(case: str) -> None:
    act, sentence = PARTS[case]
    assert sentence in refused(act)
