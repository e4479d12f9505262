"""From a layout to a WAD: regions, textures, geometry, things, scripts."""

import hashlib
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from toponav.envs.engines.doom.art import (
    Picture,
    colormap,
    encode_png,
    playpal,
    sprites,
    textures,
)
from toponav.envs.engines.doom.level import acs
from toponav.envs.engines.doom.level.actors import (
    APPLE_SPRITE,
    GOAL_SPRITE,
    SKY_TEXTURE,
    decorate,
    zmapinfo,
)
from toponav.envs.engines.doom.level.udmf import Edge, Surfaces, textmap, wall_edges
from toponav.envs.engines.doom.level.wad import build_wad
from toponav.envs.game import Look
from toponav.envs.layout import Layout
from toponav.envs.regions import assign_regions

_DOOR = "MZDOOR"
# More paintings or marked walls than this are reused, which keeps large mazes small.
_MOST_PAINTINGS = _MOST_MARKED = 256
# Neighbouring regions get hues far apart: the golden ratio's fractions.
_HUE_STEP = (5**0.5 - 1) / 2


class CompiledMaze(NamedTuple):
    """A WAD file's content, and the name of its map, which no other file's map has."""

    wad: bytes
    map_name: str


@lru_cache(maxsize=32)
def compile_maze(
    layout: Layout,
    look: Look = Look(),  # noqa: B008 (immutable)
) -> CompiledMaze:
    """Compile a layout; the same arguments give the same bytes."""
    generator = np.random.default_rng(look.texture_seed)
    images, surfaces = _decorate_surfaces(layout, look, generator)
    geometry = textmap(layout, surfaces)
    art = [(name, encode_png(image)) for name, image in images.items()]
    digest = hashlib.sha256(geometry.encode())
    for _, content in art:
        digest.update(content)
    map_name = "MZ" + digest.hexdigest()[:6].upper()
    # The offset puts a sprite's foot, its bottom centre, on the floor.
    apple, goal = (
        encode_png(image, (image.shape[1] // 2, image.shape[0]))
        for image in (sprites.apple(), sprites.goal())
    )
    lumps = [
        ("PLAYPAL", playpal()),
        ("COLORMAP", colormap()),
        ("DECORATE", decorate().encode()),
        ("ZMAPINFO", zmapinfo(map_name).encode()),
        ("TX_START", b""),
        *art,
        ("TX_END", b""),
        ("S_START", b""),
        (f"{APPLE_SPRITE}A0", apple),
        (f"{GOAL_SPRITE}A0", goal),
        ("S_END", b""),
        (map_name, b""),
        ("TEXTMAP", geometry.encode()),
        ("BEHAVIOR", acs.behavior()),
        ("ENDMAP", b""),
    ]
    return CompiledMaze(build_wad(lumps), map_name)


def _decorate_surfaces(
    layout: Layout, look: Look, generator: np.random.Generator
) -> tuple[dict[str, Picture], Surfaces]:
    """Draw all textures and say which wall edge and floor shows which."""
    regions, num_regions = assign_regions(layout, generator)
    styles = generator.permutation(max(num_regions, textures.NUM_STYLES))
    first_hue = generator.random()
    images = {SKY_TEXTURE: textures.sky(generator), _DOOR: textures.door()}
    hues = [(first_hue + region * _HUE_STEP) % 1.0 for region in range(num_regions)]
    for region, hue in enumerate(hues):
        style = int(styles[region]) % textures.NUM_STYLES
        images[f"MW{region}"] = textures.wall(style, hue, generator)
        images[f"MF{region}"] = textures.floor(style, (hue + 0.5) % 1.0, generator)
    edges = wall_edges(layout)
    walls = {edge: f"MW{regions[edge[0]]}" for edge in edges}

    def draw_edges(share: float) -> list[Edge]:
        order = generator.permutation(len(edges))
        return [edges[index] for index in sorted(order[: round(share * len(edges))])]

    used, most = [0] * num_regions, max(_MOST_MARKED // num_regions, 1)
    for edge in draw_edges(look.marks):
        region = regions[edge[0]]
        # The engine reads eight letters of a name.
        name = f"N{region:03X}{used[region] % most:02X}"
        used[region] += 1
        if name not in images:
            images[name] = textures.marked(images[walls[edge]], hues[region], generator)
        walls[edge] = name
    for number, edge in enumerate(draw_edges(look.paintings)):
        name = f"MP{number % _MOST_PAINTINGS}"
        if name not in images:
            images[name] = textures.painting(images[walls[edge]], generator)
        walls[edge] = name
    floors = [f"MF{region}" for region in range(num_regions)]
    shown = {*walls.values(), *floors, SKY_TEXTURE, _DOOR}
    images = {name: image for name, image in images.items() if name in shown}
    return images, Surfaces(walls=walls, floors=floors, regions=regions, door=_DOOR)
