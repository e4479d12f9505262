"""From a layout to a level file that the engine loads."""
