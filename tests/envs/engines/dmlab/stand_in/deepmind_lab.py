"""A stand-in for the Python module of DeepMind Lab, as strict as the real one.

It runs one level, ``level.lua`` of the package, whose properties and observations it
has. How it moves was recorded from the real engine (`recorded.json`); where nothing was
recorded, it refuses. No picture is drawn: a view is a pattern of pose and map.
"""

import hashlib
import json
import math
import os
from pathlib import Path

import numpy as np

_RECORDED = json.loads(Path(__file__).with_name("recorded.json").read_text())
_CELL, _RADIUS = 100.0, _RECORDED["radius"]
_FRAME = 0.016
_OBSERVATIONS = ("RGB_INTERLEAVED", "RGBD_INTERLEAVED", "POSE")
_LEVEL_SETTINGS = ("regions", "styles", "pictures")
_ENGINE_SETTINGS = ("width", "height", "fps", "minimalUI", "appendCommand")


class Lab:
    """One engine; what it refuses, it refuses in the real one's words."""

    def __init__(
        self,
        level,
        observations,
        config=None,
        renderer="software",
        level_cache=None,
        temp_folder=None,
    ):
        _check(level, observations, config or {}, renderer)
        self._size = int(config["height"]), int(config["width"])
        self._names, self._config = observations, config
        self._cache, self._folder = level_cache, Path(temp_folder)
        self._folder.joinpath("engine").mkdir()
        self._written, self._running, self._maps = None, False, set()

    def write_property(self, key, value):
        if type(key) is not str or type(value) is not str:
            raise TypeError("write_property() arguments must be str")
        if key == "scene":
            self._written = value
        elif key == "respawn":
            self._start = [float(number) for number in value.split()]
        else:
            raise KeyError(f"'{key}' not found.")

    def reset(self, episode=-1, seed=None):
        if seed is not None and type(seed) is not int:
            kind = type(seed).__name__
            raise ValueError(f"'seed' must be int or None, was '{kind}'.")
        if self._written is not None:
            self._read(self._written)
            self._written = None
            self._load_map()
        self._running, self._finished = True, False
        self._put()
        return True

    def step(self, action, num_steps=1):
        if type(action) is not np.ndarray:
            kind = type(action).__name__
            raise TypeError(f"argument 1 must be numpy.ndarray, not {kind}")
        if not self._running:
            raise RuntimeError("Environment in wrong status to advance.")
        if action.shape != (7,):
            raise ValueError("action must have shape (7)")
        if action.dtype != np.intc:
            raise ValueError("action must have dtype np.intc")
        reward = 0.0
        for _ in range(num_steps):
            reward += self._frame(action)
        return reward

    def observations(self):
        if not self._running:
            message = "Environment in wrong status for call to observations()"
            raise RuntimeError(message)
        return {name: self._observe(name) for name in self._names}

    def is_running(self):
        return self._running

    def close(self):
        was, self._running = self._running, False
        return was

    # What the level's script does.

    def _read(self, text):
        lines = [line.split(" ", 1) for line in text.split("\n")]
        self._rows = [rest for word, rest in lines if word == "row"]
        if sum("P" in row for row in self._rows) != 1:
            raise RuntimeError("Couldn't find a spawn point")
        found = {word: rest for word, rest in lines if word in ("map", "start", "goal")}
        self._map = found["map"]
        self._start = [float(number) for number in found["start"].split()]
        self._goal = found.get("goal")
        self._apples = [rest for word, rest in lines if word == "apple"]

    def _load_map(self):
        if self._map in self._maps:
            return
        content = repr((self._rows, sorted(self._config.items())))
        digest = hashlib.md5(content.encode()).hexdigest()
        key, path = f"{self._map}_noaas_{digest}", self._folder / f"{self._map}.pk3"
        if self._cache is None or not self._cache.fetch(key, str(path)):
            if os.environ.get("STAND_IN") == "compiles nothing":
                raise RuntimeError("the stand-in was told to compile nothing")
            path.write_text(content)
            if self._cache is not None:
                self._cache.write(key, str(path))
        assert path.read_text() == content
        self._maps.add(self._map)

    def _put(self):
        self._x, self._y, self._yaw = self._start
        self._speed = np.zeros(2)

    def _frame(self, action):
        if self._finished:  # the frame after the goal puts the agent elsewhere
            self._finished = False
            self._put()
        self._yaw -= _RECORDED["degrees_per_pixel"] * int(action[0])
        self._accelerate(int(action[3]))
        for axis, moved in enumerate(self._speed * _FRAME):
            place = [self._x, self._y]
            place[axis] += moved
            if self._is_free(*place):
                self._x, self._y = place
            else:
                self._speed[axis] = 0.0
        return self._touch()

    def _accelerate(self, move):
        # Friction and acceleration of Quake's players on the ground.
        speed = math.hypot(*self._speed)
        if speed < 1.0:
            self._speed[:] = 0.0
        else:
            drop = max(speed, 100.0) * 6.0 * _FRAME
            self._speed *= max(speed - drop, 0.0) / speed
        angle = math.radians(self._yaw)
        wish = move * np.array([math.cos(angle), math.sin(angle)])
        missing = 320.0 * abs(move) - float(self._speed @ wish)
        self._speed += max(min(10.0 * _FRAME * 320.0, missing), 0.0) * wish

    def _is_free(self, x, y):
        height = len(self._rows)
        return all(
            self._rows[height - 1 - int((y + dy) // _CELL)][int((x + dx) // _CELL)]
            != "*"
            for dx in (-_RADIUS, _RADIUS)
            for dy in (-_RADIUS, _RADIUS)
        )

    def _touch(self):
        reward = 0.0
        for apple in [one for one in self._apples if self._is_near(one)]:
            self._apples.remove(apple)
            reward += 1.0
        if self._goal is not None and self._is_near(self._goal):
            self._finished = True
            reward += 10.0
        return reward

    def _is_near(self, place):
        x, y = (float(number) for number in place.split())
        reach = _RECORDED["reach"]
        return max(abs(self._x - x), abs(self._y - y)) <= reach

    def _observe(self, name):
        if name == "POSE":
            return np.array([self._x, self._y, self._yaw])
        height, width = self._size
        channels = 4 if "RGBD" in name else 3
        seen = (round(self._x, 3), round(self._y, 3), round(self._yaw % 360.0, 3))
        content = repr((seen, self._map, len(self._apples))).encode()
        colours = hashlib.sha256(content).digest()[:channels]
        view = np.empty((height, width, channels), dtype=np.uint8)
        view[:] = np.frombuffer(colours, dtype=np.uint8)
        return view


def _check(level, observations, config, renderer):
    if type(observations) is not list:
        kind = type(observations).__name__
        raise TypeError(f"argument 2 must be list, not {kind}")
    _check_config(config)
    if renderer not in ("hardware", "software"):
        message = 'Failed to set renderer must be "hardware" or "software" actual'
        raise RuntimeError(f'{message} "{renderer}"!')
    if not (level.endswith("level.lua") and Path(level).is_file()):
        raise RuntimeError(f"Invalid levelName flag '{level}' - Level not found")
    for name in observations:
        if name not in _OBSERVATIONS:
            raise ValueError(f"Unknown observation '{name}'.")


def _check_config(config):
    for key, value in config.items():
        if type(key) is not str or type(value) is not str:
            raise TypeError("bad argument type for built-in operation")
        if key not in (*_LEVEL_SETTINGS, *_ENGINE_SETTINGS):
            raise RuntimeError(f"the stand-in has not seen the setting {key!r}")
    if int(config["width"]) % 4 or int(config["height"]) % 4:
        raise RuntimeError("width and height must be multiples of 4")
    if config["fps"] != "60":
        raise RuntimeError("the stand-in was recorded at 60 frames a second")


def version():
    return "1.0"


if os.environ.get("STAND_IN") == "dies on import":
    raise SystemExit("the stand-in was told to die")
