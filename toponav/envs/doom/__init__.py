"""The ViZDoom engine: art, WAD compiler, scripts, process handling."""
