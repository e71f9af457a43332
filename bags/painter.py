# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A frame as people look at it: the picture, and beside it reward, speed, controls, Q-values."""
from __future__ import annotations

import math

from PIL import Image, ImageDraw, ImageFont
import numpy as np

from bags.frames import RecordedFrame
from msgs_bridge.bars import share_between
from msgs_bridge.step import Q_VALUE_AXES, Q_VALUE_EXTRAS, Step
from msgs_bridge.twists import Command

PANEL_WIDTH = 320
MARGIN = 14
# nine actions fit beside a picture of CarRacing
LINE = 19
FONT_SIZE = 14
BACKGROUND = (24, 26, 30)
TEXT = (230, 230, 230)
DIM = (150, 150, 155)
GREEN = (90, 190, 110)
RED = (215, 95, 85)
BLUE = (95, 150, 220)


class FramePainter:
    """Paints frames of one size."""

    def __init__(self, width: int, height: int, scale: int) -> None:
        """Prepare pictures of frames of some pixels, `scale` times as large."""
        self._picture = width * scale, height * scale
        # encoders want even numbers
        self.width = self._picture[0] + PANEL_WIDTH + self._picture[0] % 2
        self.height = max(self._picture[1], 384) + max(self._picture[1], 384) % 2
        self._font = ImageFont.load_default(FONT_SIZE)

    def paint(self, frame: RecordedFrame, q_values: dict[str, float]) -> np.ndarray:
        """
        Return the picture, uint8 (height, width, 3).

        Args:
            frame: what was recorded; a missing image stays dark.
            q_values: of the newest decision, as the `q_values` topic names them; those that are
                not finite are left out.
        """
        canvas = Image.new('RGB', (self.width, self.height), BACKGROUND)
        if frame.pixels is not None:
            picture = Image.fromarray(np.ascontiguousarray(frame.pixels))
            canvas.paste(picture.resize(self._picture, Image.Resampling.NEAREST))
        draw = ImageDraw.Draw(canvas)
        left = self._picture[0] + MARGIN
        top = self._numbers(draw, frame.step, left)
        top = self._controls(draw, frame.step.info, left, top)
        self._q_values(draw, q_values, left, top)
        return np.asarray(canvas)

    def _numbers(self, draw: ImageDraw.ImageDraw, step: Step, left: int) -> int:
        info = step.info
        rows = [
            ('episode', f'{step.episode}'),
            ('frame', f'{info.get("step", step.decision):.0f}'),
            ('return', f'{step.episode_return:.1f}'),
            ('reward', f'{step.reward:+.2f}')]
        if 'speed' in info:
            rows.append(('speed', f'{info["speed"]:.1f}'))
        if 'tiles_total' in info:
            rows.append(
                ('tiles', f'{info.get("tiles_visited", 0):.0f} / {info["tiles_total"]:.0f}'))
        top = MARGIN
        for name, value in rows:
            draw.text((left, top), name, DIM, self._font)
            colour = TEXT
            if name == 'reward':
                colour = GREEN if step.reward > 0 else RED
            draw.text((left + 100, top), value, colour, self._font)
            top += LINE
        return top + LINE // 2

    def _controls(
        self, draw: ImageDraw.ImageDraw, info: dict[str, float], left: int, top: int,
    ) -> int:
        linear, angular = Command(info.get('linear', 0.0), info.get('angular', 0.0)).clamped()
        width = PANEL_WIDTH - 100 - 2 * MARGIN
        for name, value, colour in (
            ('steer', -angular, BLUE), ('gas', max(linear, 0.0), GREEN),
            ('brake', max(-linear, 0.0), RED),
        ):
            draw.text((left, top), name, DIM, self._font)
            origin = left + 100 + (width // 2 if name == 'steer' else 0)
            reach = round(value * (width // 2 if name == 'steer' else width))
            _bar(draw, origin, top, reach, colour)
            top += LINE
        return top + LINE // 2

    def _q_values(
        self, draw: ImageDraw.ImageDraw, q_values: dict[str, float], left: int, top: int,
    ) -> None:
        names = [name for name in q_values if name not in {**Q_VALUE_EXTRAS, **Q_VALUE_AXES}]
        actions = [(number, name, q_values[name]) for number, name in enumerate(names)
                   if math.isfinite(q_values[name])]
        if not actions:
            return
        chosen = {q_values.get(name, -1) for name in ('chosen', 'chosen_second')}
        width = PANEL_WIDTH - 170 - 2 * MARGIN
        # of more than there is room for, what was chosen and the highest
        actions = sorted(sorted(
            actions, key=lambda row: (row[0] not in chosen, -row[2])
        )[:(self.height - top) // LINE])
        lowest = min(value for _, _, value in actions)
        highest = max(value for _, _, value in actions)
        for number, name, value in actions:
            colour = TEXT if number in chosen else DIM
            draw.text((left, top), name[:13], colour, self._font)
            draw.text((left + 105, top), f'{value:7.2f}', colour, self._font)
            # the bars show the differences, which are small beside the values
            _bar(draw, left + 170, top,
                 2 + round(share_between(value, lowest, highest) * (width - 2)),
                 GREEN if number in chosen else BLUE)
            top += LINE


def _bar(draw: ImageDraw.ImageDraw, origin: int, top: int, reach: int, colour: tuple) -> None:
    left, right = sorted((origin, origin + reach))
    draw.rectangle((left, top + 4, right, top + FONT_SIZE), colour)
