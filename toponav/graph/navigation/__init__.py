"""From a map and a picture of the goal to actions."""
