"""The art of a maze: palette, textures, sprites and the files made of them."""

import io
import itertools
import struct
import zlib
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from toponav.envs.engines.doom.art import sprites, textures
from toponav.envs.engines.doom.art.palette import (
    PALETTE,
    colormap,
    colour_index,
    encode_png,
    playpal,
)

Picture = NDArray[np.uint8]
Draw = Callable[[np.random.Generator], Picture]

STYLES = range(textures.NUM_STYLES)
WALL = textures.wall(0, 0.6, np.random.default_rng(0))
PAINTINGS = [textures.painting(WALL, np.random.default_rng(seed)) for seed in range(24)]
# One picture of every kind, each drawn from a generator.
DRAWN: dict[str, Draw] = {
    **{f"wall{s}": partial(textures.wall, s, s / 6) for s in STYLES},
    **{f"floor{s}": partial(textures.floor, s, s / 6) for s in STYLES},
    "painting": partial(textures.painting, WALL),
    "marked": partial(textures.marked, WALL, 0.6),
    "sky": textures.sky,
    "door": lambda rng: textures.door(),
}
SPRITES = {"apple": sprites.apple, "goal": sprites.goal}


def chunks(file: bytes) -> list[tuple[bytes, bytes]]:
    """Kind and data of every chunk of a PNG file, in order, checksums checked."""
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    found, position = [], 8
    while position < len(file):
        (length,) = struct.unpack_from(">I", file, position)
        kind, end = file[position + 4 : position + 8], position + 8 + length
        data = file[position + 8 : end]
        assert struct.unpack_from(">I", file, end) == (zlib.crc32(kind + data),)
        found.append((kind, data))
        position = end + 4
    return found


def decoded(file: bytes, mode: str) -> Picture:
    with Image.open(io.BytesIO(file)) as image:
        return np.asarray(image.convert(mode))


def thumbnail(picture: Picture) -> NDArray[np.float64]:
    """A 128 x 128 picture as it looks from about three cells away: 16 x 16, RGB."""
    colours = PALETTE[picture].reshape(16, 8, 16, 8, 3)
    small: NDArray[np.float64] = colours.mean(axis=(1, 3))
    return small


class TestPalette:
    def test_has_256_distinct_colours(self) -> None:
        assert PALETTE.dtype == np.uint8
        assert PALETTE.shape == (256, 3)
        assert len(np.unique(PALETTE, axis=0)) == 256

    def test_starts_with_greys_from_black_to_white(self) -> None:
        # Steps of 255 / 15 = 17.
        assert PALETTE[:16].tolist() == [[17 * i] * 3 for i in range(16)]

    def test_cannot_be_written(self) -> None:
        with pytest.raises(ValueError, match="read-only"):
            PALETTE[0, 0] = 1

    @pytest.mark.parametrize(
        ("hue", "name"), [(0.0, "red"), (0.5, "cyan"), (0.75, "violet")]
    )
    def test_has_the_hues_that_doom_lacks(self, hue: float, name: str) -> None:
        # Violet is three quarters round the circle, halfway from blue to magenta.
        expected = {"red": [255, 0, 0], "cyan": [0, 255, 255], "violet": [128, 0, 255]}
        assert PALETTE[colour_index(hue, 2, 3)].tolist() == expected[name]

    def test_indices_cover_the_coloured_part_once(self) -> None:
        hues = np.arange(20) / 20
        grid = itertools.product(hues, range(3), range(4))
        assert sorted(colour_index(*cell) for cell in grid) == list(range(16, 256))

    def test_hue_is_a_circle(self) -> None:
        # 0.98 lies 0.4 steps of 1/20 before red, and 1.02 as much behind it.
        assert {colour_index(h, 1, 1) for h in (-1.0, 0.0, 0.98, 1.02, 2.0)} == {
            colour_index(0.0, 1, 1)
        }

    def test_brighter_values_are_brighter(self) -> None:
        shades = [PALETTE[colour_index(0.4, 1, value)].sum() for value in range(4)]
        assert shades == sorted(set(shades))

    def test_every_flash_is_the_palette(self) -> None:
        flashes = np.frombuffer(playpal(), np.uint8).reshape(14, 256, 3)
        assert (flashes == PALETTE).all()


class TestColormap:
    rows = np.frombuffer(colormap(), np.uint8).reshape(34, 256)

    @pytest.mark.parametrize("level", [0, 1, 10, 31])
    def test_every_entry_is_the_nearest_of_its_light(self, level: int) -> None:
        lit = np.round(PALETTE * (1 - level / 32))
        offset = lit[:, None] - PALETTE.astype(float)
        nearest = np.square(offset).sum(axis=-1).argmin(axis=-1)
        np.testing.assert_array_equal(self.rows[level], nearest)

    def test_full_light_changes_nothing(self) -> None:
        np.testing.assert_array_equal(self.rows[0], np.arange(256))

    def test_light_fades_from_level_to_level(self) -> None:
        # 31/32 of every colour is still nearest to itself: levels 0 and 1 agree.
        light = PALETTE[self.rows[:32]].mean(axis=(1, 2))
        assert light[0] == light[1]
        assert (np.diff(light[1:]) < 0).all()

    def test_half_light_of_white_is_the_middle_grey(self) -> None:
        # Level 16 halves 255 to 127.5; the greys beside it are 119 and 136.
        assert PALETTE[self.rows[16, 15]].tolist() in ([119] * 3, [136] * 3)

    def test_ends_with_inverted_grey_and_black(self) -> None:
        assert (self.rows[32, 0], self.rows[32, 15]) == (15, 0)
        assert not self.rows[33].any()


class TestTextures:
    @pytest.mark.parametrize("kind", DRAWN)
    def test_same_seed_draws_the_same_picture(self, kind: str) -> None:
        first, second = (DRAWN[kind](np.random.default_rng(7)) for _ in range(2))
        np.testing.assert_array_equal(first, second)

    @pytest.mark.parametrize("kind", DRAWN)
    def test_is_drawn_in_palette_indices(self, kind: str) -> None:
        picture = DRAWN[kind](np.random.default_rng(1))
        assert picture.dtype == np.uint8
        assert picture.shape == (128, 256 if kind == "sky" else 128)

    @pytest.mark.parametrize("hue", np.arange(0, 1, 0.1))
    @pytest.mark.parametrize("draw", [textures.wall, textures.floor])
    def test_is_bright_in_every_hue(
        self, draw: Callable[..., Picture], hue: float
    ) -> None:
        rng = np.random.default_rng(2)
        assert min(PALETTE[draw(style, hue, rng)].mean() for style in STYLES) > 70

    @pytest.mark.parametrize("draw", [textures.wall, textures.floor])
    def test_styles_differ_even_in_one_hue(self, draw: Callable[..., Picture]) -> None:
        looks = [thumbnail(draw(s, 0.3, np.random.default_rng(3))) for s in STYLES]
        for one, other in itertools.combinations(looks, 2):
            assert np.abs(one - other).mean() > 15

    def test_seed_matters(self) -> None:
        for style in STYLES:
            looks = [
                textures.wall(style, 0.3, np.random.default_rng(seed)).tobytes()
                for seed in range(8)
            ]
            assert len(set(looks)) > 1

    def test_door_is_not_like_any_wall(self) -> None:
        # Even a wall of the door's own hue.
        door, rng = thumbnail(textures.door()), np.random.default_rng(0)
        for style in STYLES:
            look = thumbnail(textures.wall(style, 0.05, rng))
            assert np.abs(door - look).mean() > 40


class TestPaintings:
    def test_leave_the_wall_around_them(self) -> None:
        for picture in PAINTINGS:
            np.testing.assert_array_equal(picture[:, :1], WALL[:, :1])
            np.testing.assert_array_equal(picture[-8:], WALL[-8:])

    def test_cover_much_of_the_wall(self) -> None:
        for picture in PAINTINGS:
            assert (picture != WALL).mean() > 0.2

    def test_do_not_change_the_wall_they_are_given(self) -> None:
        wall = WALL.copy()
        textures.painting(wall, np.random.default_rng(99))
        np.testing.assert_array_equal(wall, WALL)

    def test_each_is_unlike_all_others(self) -> None:
        for one, other in itertools.combinations(PAINTINGS, 2):
            assert (one != other).mean() > 0.2
            # The closest of 11,175 pairs was 16 apart.
            assert np.abs(thumbnail(one) - thumbnail(other)).mean() > 12


class TestSprites:
    @pytest.mark.parametrize(
        ("name", "shape"), [("apple", (28, 24)), ("goal", (48, 40))]
    )
    def test_are_cut_out_in_palette_colours(
        self, name: str, shape: tuple[int, int]
    ) -> None:
        sprite = SPRITES[name]()
        assert sprite.shape == (*shape, 4)
        assert set(np.unique(sprite[..., 3])) == {0, 255}
        colours = {tuple(colour) for colour in sprite[sprite[..., 3] > 0][:, :3]}
        assert colours <= {tuple(colour) for colour in PALETTE}
        assert not sprite[sprite[..., 3] == 0].any()

    @pytest.mark.parametrize("name", SPRITES)
    def test_stand_on_their_lowest_row(self, name: str) -> None:
        assert SPRITES[name]()[-1, :, 3].any()

    def test_apple_is_red_and_goal_is_golden(self) -> None:
        for sprite, hue in ((sprites.apple(), 0.0), (sprites.goal(), 0.15)):
            solid = sprite[sprite[..., 3] > 0][:, :3]
            main = (solid == PALETTE[colour_index(hue, 2, 3)]).all(axis=-1)
            assert main.mean() > 0.25


class TestEncodePng:
    @pytest.mark.parametrize("kind", DRAWN)
    def test_decodes_to_the_picture(self, kind: str) -> None:
        picture = DRAWN[kind](np.random.default_rng(4))
        np.testing.assert_array_equal(
            decoded(encode_png(picture), "RGB"), PALETTE[picture]
        )

    def test_keeps_a_sprite_as_it_is(self) -> None:
        rgba = np.random.default_rng(5).integers(0, 256, (20, 30, 4), dtype=np.uint8)
        np.testing.assert_array_equal(decoded(encode_png(rgba), "RGBA"), rgba)

    def test_takes_indices_as_they_are(self) -> None:
        index = np.arange(256, dtype=np.uint8).reshape(16, 16)
        file = encode_png(index)
        assert dict(chunks(file))[b"PLTE"] == PALETTE.tobytes()
        with Image.open(io.BytesIO(file)) as image:
            assert image.mode == "P"
            np.testing.assert_array_equal(np.asarray(image), index)

    def test_offsets_follow_the_header(self) -> None:
        found = chunks(encode_png(sprites.apple(), (12, -28)))
        assert [kind for kind, _ in found] == [b"IHDR", b"grAb", b"IDAT", b"IEND"]
        assert found[1][1] == b"\x00\x00\x00\x0c\xff\xff\xff\xe4"

    def test_textures_have_no_offsets(self) -> None:
        kinds = [kind for kind, _ in chunks(encode_png(textures.door()))]
        assert kinds == [b"IHDR", b"PLTE", b"IDAT", b"IEND"]

    def test_same_picture_gives_the_same_bytes(self) -> None:
        assert encode_png(sprites.goal(), (20, 48)) == encode_png(
            sprites.goal(), (20, 48)
        )
