"""From a layout to a WAD: regions, textures, geometry, things, scripts."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from toponav.envs.doom import acs, sprites, textures
from toponav.envs.doom.actors import (
    APPLE_SPRITE,
    GOAL_SPRITE,
    SKY_TEXTURE,
    decorate,
    zmapinfo,
)
from toponav.envs.doom.marks import marked
from toponav.envs.doom.palette import colormap, playpal
from toponav.envs.doom.png import encode_png
from toponav.envs.doom.regions import assign_regions
from toponav.envs.doom.udmf import Surfaces, textmap, wall_edges
from toponav.envs.doom.wad import build_wad
from toponav.envs.layout import Layout

_DOOR = "MZDOOR"
# More paintings or marked walls than this are used twice: large mazes stay small on
# disk.
_MOST_PAINTINGS = _MOST_MARKED = 256
# Neighbouring regions get hues far apart: the golden ratio's fractions.
_HUE_STEP = (5**0.5 - 1) / 2

_Image = NDArray[np.uint8]


@dataclass(frozen=True)
class CompiledMaze:
    """A maze that the engine can load.

    Args:
        wad: content of the WAD file.
        map_name: name of the map in it; derived from the content, so that the
            engine cannot take another file's map for it.
    """

    wad: bytes
    map_name: str

    @property
    def digest(self) -> str:
        """SHA-256 of the WAD in hexadecimal."""
        return hashlib.sha256(self.wad).hexdigest()


@lru_cache(maxsize=32)
def compile_maze(
    layout: Layout,
    *,
    texture_seed: int = 0,
    paintings: float = 0.5,
    marks: float = 1.0,
) -> CompiledMaze:
    r"""Compile a layout; the same arguments give the same bytes.

    Args:
        layout: the maze.
        texture_seed: draws regions, wall styles, hues, paintings and marks.
        paintings: share of the wall edges with a painting, in [0, 1]. It decides
            how recognisable places are.
        marks: share of the wall edges with small marks of their own, in [0, 1]. It
            decides how recognisable they are from close by.

    Raises:
        ValueError: if ``paintings`` or ``marks`` is out of range.

    Examples:
        >>> maze = compile_maze(Layout("*****\n*   *\n*****", name="lane"))
        >>> maze.map_name[:2], maze.wad[:4]
        ('MZ', b'PWAD')
    """
    for name, share in (("paintings", paintings), ("marks", marks)):
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"{name} must lie in [0, 1], got {share}")
    generator = np.random.default_rng(texture_seed)
    images, surfaces = _decorate_surfaces(layout, paintings, marks, generator)
    geometry = textmap(layout, surfaces)
    art = [(name, encode_png(image)) for name, image in images.items()]
    digest = hashlib.sha256(geometry.encode())
    for _, content in art:
        digest.update(content)
    map_name = "MZ" + digest.hexdigest()[:6].upper()
    return CompiledMaze(build_wad(list(_lumps(map_name, geometry, art))), map_name)


def _decorate_surfaces(
    layout: Layout, paintings: float, marks: float, generator: np.random.Generator
) -> tuple[dict[str, _Image], Surfaces]:
    """Draw all textures and say which wall edge and floor shows which."""
    regions, num_regions = assign_regions(layout, generator)
    styles = generator.permutation(max(num_regions, textures.NUM_STYLES))
    first_hue = generator.random()
    images: dict[str, _Image] = {
        SKY_TEXTURE: textures.sky(generator),
        _DOOR: textures.door(),
    }
    hues = [(first_hue + region * _HUE_STEP) % 1.0 for region in range(num_regions)]
    for region, hue in enumerate(hues):
        style = int(styles[region]) % textures.NUM_STYLES
        images[f"MW{region}"] = textures.wall(style, hue, generator)
        images[f"MF{region}"] = textures.floor(style, (hue + 0.5) % 1.0, generator)
    edges = wall_edges(layout)
    walls = {edge: f"MW{regions[edge[0]]}" for edge in edges}
    chosen = generator.permutation(len(edges))[: round(marks * len(edges))]
    used, most = [0] * num_regions, max(_MOST_MARKED // num_regions, 1)
    for index in sorted(int(i) for i in chosen):
        edge = edges[index]
        region = regions[edge[0]]
        # The engine reads eight letters of a name.
        name = f"N{region:03X}{used[region] % most:02X}"
        used[region] += 1
        if name not in images:
            images[name] = marked(images[walls[edge]], hues[region], generator)
        walls[edge] = name
    hung = generator.permutation(len(edges))[: round(paintings * len(edges))]
    for number, index in enumerate(sorted(int(i) for i in hung)):
        name = f"MP{number % _MOST_PAINTINGS}"
        edge = edges[index]
        if name not in images:
            images[name] = textures.painting(images[walls[edge]], generator)
        walls[edge] = name
    floors = [f"MF{region}" for region in range(num_regions)]
    shown = {*walls.values(), *floors, SKY_TEXTURE, _DOOR}
    images = {name: image for name, image in images.items() if name in shown}
    return images, Surfaces(walls=walls, floors=floors, regions=regions, door=_DOOR)


def _lumps(
    map_name: str, geometry: str, art: list[tuple[str, bytes]]
) -> Iterator[tuple[str, bytes]]:
    yield "PLAYPAL", playpal()
    yield "COLORMAP", colormap()
    script = decorate(acs.APPLE_TOUCHED, acs.GOAL_TOUCHED)
    yield "DECORATE", script.encode()
    yield "ZMAPINFO", zmapinfo(map_name).encode()
    yield "TX_START", b""
    yield from art
    yield "TX_END", b""
    yield "S_START", b""
    for name, image in ((APPLE_SPRITE, sprites.apple()), (GOAL_SPRITE, sprites.goal())):
        # The offset puts the sprite's foot, its bottom centre, on the floor.
        height, width = image.shape[:2]
        yield f"{name}A0", encode_png(image, (width // 2, height))
    yield "S_END", b""
    yield map_name, b""
    yield "TEXTMAP", geometry.encode()
    yield "BEHAVIOR", acs.behavior()
    yield "ENDMAP", b""
