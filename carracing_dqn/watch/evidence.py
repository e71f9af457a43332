# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What pictures and twists of a car say of its camera, its rate and its steering."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
import statistics

from PIL import Image
import numpy as np

from carracing_dqn.simulation.picture_motion import sideways_shift
from msgs_bridge.errors import BridgeError
from msgs_bridge.twists import Command

# of how many looks the last are judged; there are some a second
KEPT_LOOKS = 50
# a picture that moves is compared in this many pixels a side
SIDE = 96
# below this a car goes straight on, whatever it is told
LEAST_ANGULAR = 0.1
# a command came through unchanged within this
TOLERANCE = 0.05
# how many looks it takes to say something
ENOUGH = 8


class Evidence:
    """
    What was seen of one car lately.

    Attributes:
        periods: time between two images that followed each other; ns.
        encodings: what the images said they are.
        patches: mean colour of a part of the pictures whose colour is known.
        shifts: pixels by which the picture moved to the right, by what the car was told: 'left',
            'right'.
        applied: whether a command arrived as it was sent (1), mirrored (-1) or otherwise (0).
    """

    def __init__(self) -> None:
        """Begin with nothing; `patch` is set by who knows the camera."""
        self.patch: Sequence[int] | None = None
        self.periods: deque[int] = deque(maxlen=KEPT_LOOKS)
        self.encodings: deque[str] = deque(maxlen=KEPT_LOOKS)
        self.patches: deque[np.ndarray] = deque(maxlen=KEPT_LOOKS)
        self.shifts: Mapping[str, deque[float]] = {
            'left': deque(maxlen=KEPT_LOOKS), 'right': deque(maxlen=KEPT_LOOKS)}
        self.applied: deque[int] = deque(maxlen=KEPT_LOOKS)
        self._applied_at = -1

    def see_image(
        self, stamp: int, pixels: np.ndarray, encoding: str, *, compressed: bool,
    ) -> None:
        """Note a picture as it came, uint8 (H, W, 3)."""
        self.encodings.append(encoding)
        if self.patch is not None:
            left, top, width, height = self.patch
            part = pixels[top:top + height, left:left + width]
            if part.shape[:2] == (height, width):
                self.patches.append(part.reshape(-1, 3).mean(0))

    def see_pair(
        self, period: int, before: np.ndarray, after: np.ndarray, command: Command | None,
    ) -> None:
        """
        Note two pictures that followed each other.

        Args:
            period: ns from one stamp to the next.
            before: uint8 (H, W, 3).
            after: the next one, of the same size.
            command: what the car was told between them, None where nobody knows.
        """
        if period <= 0:
            return
        self.periods.append(period)
        if command is None or abs(command.angular) < LEAST_ANGULAR or before.shape != after.shape:
            return
        shift = sideways_shift(_small(before), _small(after))
        if shift is not None:
            self.shifts['left' if command.angular > 0 else 'right'].append(shift)

    def see_applied(self, stamp: int, sent: Command, applied: Command) -> None:
        """Note a command as it was sent and as a simulator says that it was applied."""
        if stamp == self._applied_at or abs(sent.angular) < LEAST_ANGULAR:
            return
        self._applied_at = stamp
        self.applied.append(
            1 if abs(applied.angular - sent.angular) < TOLERANCE
            else -1 if abs(applied.angular + sent.angular) < TOLERANCE else 0)

    @property
    def period(self) -> float | None:
        """Return the seconds between two images by stamp, None where too few have come."""
        return statistics.median(self.periods) / 1e9 if len(self.periods) >= ENOUGH else None

    @property
    def patch_rgb(self) -> np.ndarray | None:
        """Return the mean colour of the part that is known, None where too few have come."""
        return np.mean(self.patches, 0) if len(self.patches) >= ENOUGH else None

    @property
    def mirrored_on_the_way(self) -> bool:
        """Return whether commands arrive with left and right exchanged."""
        return len(self.applied) >= ENOUGH and (
            sum(one < 0 for one in self.applied) > 0.8 * len(self.applied))

    @property
    def turns_wrongly(self) -> bool | None:
        """Return whether the picture turns right when the car is told left; None: cannot tell."""
        if min(map(len, self.shifts.values())) < ENOUGH:
            return None
        left, right = (statistics.median(self.shifts[side]) for side in ('left', 'right'))
        spread = max(statistics.pstdev(self.shifts[side]) for side in ('left', 'right'))
        if abs(left - right) < max(0.1, 0.5 * spread):
            return None
        return left < right


def _small(pixels: np.ndarray) -> np.ndarray:
    if max(pixels.shape[:2]) <= SIDE:
        return pixels
    try:
        return np.asarray(Image.fromarray(np.ascontiguousarray(pixels)).resize((SIDE, SIDE)))
    except ValueError as error:
        raise BridgeError(str(error)) from None
