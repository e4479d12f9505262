from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import RenameTransform, SerialEnv, TransformedEnv

from tests.checks import check_parallel, check_transform
from tests.fakes import FakeMaze
from toponav.keys import PIXELS
from toponav.transforms import NoisyTV
from toponav.transforms.noisy_tv import NOISE_LAWS, QUADRANTS

# Where each quadrant of a 120 x 160 view lies.
PLACES = {
    "top_left": (slice(0, 60), slice(0, 80)),
    "top_right": (slice(0, 60), slice(80, 160)),
    "bottom_left": (slice(60, 120), slice(0, 80)),
    "bottom_right": (slice(60, 120), slice(80, 160)),
}


def grey(*shape, value=7):
    return TensorDict(
        {PIXELS: torch.full((*shape, 120, 160, 3), value, dtype=torch.uint8)},
        batch_size=shape,
    )


def reset(tv, data, rows=None):
    mask = TensorDict(batch_size=data.batch_size)
    if rows is not None:
        mask["_reset"] = torch.tensor(rows).unsqueeze(-1)
    return tv._reset(mask, data)


def quadrants_of(views):
    """Return the index of the one noisy quadrant of each view of :func:`grey`."""
    noisy = torch.stack(
        [(views[:, y, x] != 7).float().mean((1, 2, 3)) for y, x in PLACES.values()], 1
    )
    assert ((noisy > 0.98).sum(1) == 1).all()
    assert ((noisy == 0).sum(1) == 3).all()
    return noisy.argmax(1)


@pytest.mark.parametrize("quadrant", QUADRANTS)
def test_noise_fills_its_quadrant_and_nothing_else(quadrant):
    views = reset(NoisyTV(quadrant=quadrant, seed=0), grey(1))[PIXELS]
    assert quadrants_of(views).tolist() == [QUADRANTS.index(quadrant)]


def test_enlargement_is_nearest_neighbour():
    # 80 columns show 21 noise pixels: column c shows pixel floor(21 c / 80).
    tile = reset(NoisyTV(quadrant="top_left", seed=0), grey(1))[PIXELS][0, :60, :80]
    down = [row * 21 // 60 for row in range(60)]
    right = [column * 21 // 80 for column in range(80)]
    first = {r: down.index(r) for r in set(down)}
    first_column = {c: right.index(c) for c in set(right)}
    small = tile[[first[r] for r in range(21)]][:, [first_column[c] for c in range(21)]]
    assert small.shape == (21, 21, 3)
    assert torch.equal(tile, small[down][:, right])


def test_native_noise_sits_in_the_middle_of_its_quadrant():
    tv = NoisyTV(quadrant="bottom_right", scale="native", law="binary", seed=0)
    changed = (reset(tv, grey(1))[PIXELS][0] != 7).all(-1).nonzero()
    # 60 + (60 - 21) // 2 = 79 and 80 + (80 - 21) // 2 = 109, 21 pixels from there.
    assert changed.amin(0).tolist() == [79, 109]
    assert changed.amax(0).tolist() == [99, 129]
    assert len(changed) == 21 * 21


def test_odd_last_row_and_column_stay_clean():
    data = TensorDict({PIXELS: torch.full((1, 9, 7, 3), 7, dtype=torch.uint8)}, [1])
    tv = NoisyTV(quadrant="bottom_right", law="binary", seed=0)
    changed = (reset(tv, data)[PIXELS][0] != 7).all(-1).nonzero()
    assert changed.amin(0).tolist() == [4, 3]
    assert changed.amax(0).tolist() == [7, 5]


def test_noise_is_fresh_in_each_decision_and_the_quadrant_is_not():
    tv = NoisyTV(seed=0)
    views = [reset(tv, grey(8))[PIXELS]]
    views += [tv._step(grey(8), grey(8))[PIXELS] for _ in range(5)]
    places = [quadrants_of(view) for view in views]
    assert all(torch.equal(place, places[0]) for place in places)
    assert all((views[0] != view).any() for view in views[1:])


def test_every_quadrant_comes_up_equally_often():
    counts = torch.zeros(4)
    tv = NoisyTV(seed=0)
    for _ in range(50):
        reset(tv, TensorDict({PIXELS: torch.zeros(40, 4, 4, 1)}, [40]))
        counts += tv.corner.bincount(minlength=4)
    # 2000 draws: 500 each, standard deviation sqrt(2000 * 1/4 * 3/4) = 19.4.
    assert ((counts - 500).abs() < 4 * 19.4).all()


def test_partial_reset_moves_only_the_rows_that_restart():
    tv = NoisyTV(seed=0)
    reset(tv, grey(64))
    before = tv.corner.clone()
    rows = [index % 2 == 0 for index in range(64)]
    reset(tv, grey(64), rows)
    assert torch.equal(tv.corner[1::2], before[1::2])
    # 32 new draws all equal to the old ones: chance 4**-32.
    assert (tv.corner[::2] != before[::2]).any()


def test_uniform_law_has_the_moments_of_0_to_255():
    draw = NOISE_LAWS["uniform"]((200, 21, 21, 3), torch.Generator().manual_seed(0))
    # 264,600 draws: mean 127.5 +- 0.14, variance (256**2 - 1) / 12 = 5461.25.
    assert draw.float().mean().item() == pytest.approx(127.5, abs=0.6)
    assert draw.float().var().item() == pytest.approx(5461.25, rel=0.01)
    assert (draw.min(), draw.max()) == (0, 255)


def test_other_laws():
    binary = NOISE_LAWS["binary"]((1000,), torch.Generator().manual_seed(0))
    assert binary.unique().tolist() == [0, 255]
    normal = NOISE_LAWS["normal"]((9999,), torch.Generator().manual_seed(0)).float()
    assert normal.mean().item() == pytest.approx(127.5, abs=2.0)
    assert normal.std().item() == pytest.approx(49.5, abs=1.5)  # cut at both ends


def test_own_law():
    def white(shape, generator):
        return torch.full(shape, 255, dtype=torch.uint8)

    tv = NoisyTV(quadrant="top_left", law=white, seed=0)
    assert (reset(tv, grey(2))[PIXELS][:, :60, :80] == 255).all()


def test_float_views_get_noise_in_0_to_1():
    data = TensorDict({PIXELS: torch.full((2, 8, 8, 3), 0.5)}, [2])
    view = reset(NoisyTV(quadrant="top_left", seed=0), data)[PIXELS]
    whole = NoisyTV(quadrant="top_left", seed=0)._draw_noise(2, 3)
    expected = whole[:, [0, 5, 10, 15]][:, :, [0, 5, 10, 15]].float() / 255
    assert torch.equal(view[:, :4, :4], expected)
    assert (view[:, 4:] == 0.5).all()


def test_channels_first_shows_the_same_noise():
    first = grey(3)
    last = grey(3).apply(lambda pixels: pixels.movedim(-1, -3).contiguous())
    hwc = reset(NoisyTV(seed=5), first)[PIXELS]
    chw = reset(NoisyTV(seed=5, channels="CHW"), last)[PIXELS]
    assert torch.equal(hwc, chw.movedim(-3, -1))


def test_two_views_of_an_env_show_the_same_noise():
    data = TensorDict(
        {"large": torch.zeros(4, 42, 42, 3), "small": torch.zeros(4, 42, 42, 3)}, [4]
    )
    both = reset(NoisyTV(["large", "small"], seed=0), data)
    assert torch.equal(both["large"], both["small"])
    assert both["large"].any()


def test_several_views_under_one_key_share_noise_and_quadrant():
    data = TensorDict({PIXELS: torch.zeros(2, 5, 8, 8, 3)}, [2])  # five agents
    views = reset(NoisyTV(seed=0), data)[PIXELS]
    assert torch.equal(views, views[:, :1].expand_as(views))
    assert (views[0] != views[1]).any()


def test_views_are_not_painted_in_place():
    data = grey(2)
    original = data[PIXELS]
    reset(NoisyTV(seed=0), data)
    assert (original == 7).all()


def test_out_key_leaves_the_clean_view():
    env = FakeMaze(batch_size=[2])
    tv = NoisyTV([PIXELS], [("tv", "view")], size=3, seed=0)
    data = TransformedEnv(env, tv).reset()
    assert (data[PIXELS] != data["tv", "view"]).any()


def test_same_seed_same_noise():
    def views(seed):
        env = TransformedEnv(FakeMaze(batch_size=[3]), NoisyTV(size=4, seed=seed))
        torch.manual_seed(0)  # the same random actions
        return env.rollout(20, break_when_any_done=False)[PIXELS]

    assert torch.equal(views(1), views(1))
    assert (views(1) != views(2)).any()
    assert (views(None) != views(None)).any()


def test_state_dict_goes_on_where_it_was_saved():
    saved, loaded = NoisyTV(seed=0), NoisyTV(seed=1)
    reset(saved, grey(6))
    loaded.load_state_dict(saved.state_dict())
    assert torch.equal(loaded.corner, saved.corner)
    assert torch.equal(
        loaded._step(grey(6), grey(6))[PIXELS], saved._step(grey(6), grey(6))[PIXELS]
    )


def test_state_dict_survives_a_file(tmp_path):
    saved, loaded = NoisyTV(seed=0), NoisyTV(seed=1)
    reset(saved, grey(6))
    torch.save(saved.state_dict(), tmp_path / "tv.pt")
    loaded.load_state_dict(torch.load(tmp_path / "tv.pt", weights_only=True))
    assert torch.equal(loaded.generator.get_state(), saved.generator.get_state())


@pytest.mark.parametrize("float_pixels", [False, True])
def test_specs_hold_under_every_nesting(float_pixels):
    def make_env(batch_size):
        return FakeMaze(
            batch_size=batch_size, max_decisions=6, float_pixels=float_pixels
        )

    check_transform(make_env, partial(NoisyTV, size=5, seed=0))


def make_nested(batch_size):
    renamed = RenameTransform([PIXELS], [("eyes", "left")])
    env = FakeMaze(batch_size=batch_size, max_decisions=6)
    return TransformedEnv(env, renamed, auto_unwrap=False)


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
def test_specs_hold_for_a_nested_key():
    check_transform(make_nested, partial(NoisyTV, [("eyes", "left")], size=5, seed=0))


def make_maze(batch_size):
    return FakeMaze(batch_size=batch_size, max_decisions=6)


@pytest.mark.slow
def test_specs_hold_in_processes():
    check_parallel(make_maze, partial(NoisyTV, size=5, seed=0))


def test_workers_with_different_seeds_show_different_noise():
    makers = [
        lambda seed=seed: TransformedEnv(
            FakeMaze(), NoisyTV(size=5, quadrant="top_left", seed=seed)
        )
        for seed in (0, 1)
    ]
    views = SerialEnv(2, makers).reset()[PIXELS]
    assert (views[0, :6, :8] != views[1, :6, :8]).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": 0}, "size must be at least 1, got 0"),
        ({"quadrant": "middle"}, "quadrant must be one of .* got 'middle'"),
        ({"scale": "big"}, "scale must be one of .* got 'big'"),
        ({"law": "pink"}, "law must be one of .* got 'pink'"),
        ({"channels": "WHC"}, "channels must be one of .* got 'WHC'"),
        ({"out_keys": ["a", "b"]}, "out_keys must match"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        NoisyTV(**arguments)


@pytest.mark.parametrize(
    ("tv", "message"),
    [
        (
            NoisyTV(["nothing"]),
            "'nothing' must be an observation of the env, got",
        ),
        (NoisyTV([("privileged", "heading")]), "must be images, got"),
        (NoisyTV(scale="native"), "must be at least 42x42 .* got 12x16"),
    ],
)
def test_wrong_views_are_refused_with_the_specs(tv, message):
    with pytest.raises(ValueError, match=message):
        TransformedEnv(FakeMaze(), tv).observation_spec  # noqa: B018


def test_views_of_integers_are_refused():
    numbers = Composite(view=Unbounded((4, 4, 3), dtype=torch.int64))
    with pytest.raises(ValueError, match="'view' must be uint8 or floating point"):
        NoisyTV(["view"]).transform_observation_spec(numbers)


def test_views_of_floats_beyond_1_are_refused():
    data = TensorDict({PIXELS: 255 * torch.rand(2, 8, 8, 3)}, [2])
    rule = r"'pixels' must be uint8 or floating point in \[0, 1\], got 25"
    with pytest.raises(ValueError, match=rule):
        reset(NoisyTV(seed=0), data)


def test_wrong_law_is_refused():
    tv = NoisyTV(law=lambda shape, generator: torch.zeros(shape))
    with pytest.raises(ValueError, match=r"law must return uint8 .* got torch.float32"):
        reset(tv, grey(1))
