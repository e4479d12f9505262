"""What a maze looks like: textures, paintings, marks and sprites."""

from toponav.envs.engines.doom.art.palette import (
    Picture as Picture,
    colormap as colormap,
    encode_png as encode_png,
    playpal as playpal,
)
