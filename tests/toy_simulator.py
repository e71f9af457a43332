# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator as small as they come: a dot that earns by how near it is to a bar."""
import threading

from msgs_bridge.simulator import Outcome, Simulator
import numpy as np

HEIGHT, WIDTH, LAST_FRAME = 32, 48, 40


class Toy(Simulator):
    """Turning moves the dot; the episode ends on the bar, or after 40 frames."""

    frame_seconds = 0.05
    deterministic = True

    def __init__(self, settings):
        self.random = np.random.default_rng()
        self.thread = threading.get_ident()

    def reset(self, seed):
        # as OpenGL would
        assert threading.get_ident() == self.thread, 'driven in another thread than it was made in'
        if seed is not None:
            self.random = np.random.default_rng(seed)
        self.bar, away = self.random.integers((4, 8), (44, 33)).astype(float)
        self.dot = 4 + (self.bar - 4 + away) % 40
        self.frame = 0
        return Outcome(self.pixels())

    def advance(self, command, frames=1):
        before, start = abs(self.dot - self.bar), self.frame
        while self.frame < start + frames and not any(self.ends()):
            self.dot = float(np.clip(self.dot - command.angular, 2, WIDTH - 3))
            self.frame += 1
        reward = before - abs(self.dot - self.bar)
        return Outcome(self.pixels(), reward, *self.ends(), frames=self.frame - start)

    def ends(self):
        return abs(self.dot - self.bar) < 1, self.frame >= LAST_FRAME

    def pixels(self):
        pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        for place, rows, gray in ((self.bar, slice(0, 32), 90), (self.dot, slice(12, 20), 255)):
            pixels[rows, round(place) - 2:round(place) + 3] = gray
        return pixels
