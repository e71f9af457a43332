# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""How long an action is held."""
from __future__ import annotations

# A frame may come earlier than an action is due by this part of the time it is held: stamps
# jitter, and a frame rate need not divide that time.
EARLY = 8


class ActionHold:
    """
    Says at which frames to decide anew, so that on average an action is held for its time.

    With frames of 30 Hz and actions of 80 ms it decides after 67 and after 100 ms in turns; frames
    that come less often than actions are due are decided on one by one.
    """

    def __init__(self) -> None:
        """Begin: the first frame is decided on."""
        self._due: int | None = None

    def reset(self) -> None:
        """Decide on the next frame, whenever it comes."""
        self._due = None

    def is_due(self, now: int, held: int) -> bool:
        """
        Return whether to decide at a frame; whoever is told so does.

        Args:
            now: time of the frame, ns.
            held: for how long an action is held, ns.
        """
        if self._due is not None and now < self._due - held // EARLY:
            return False
        due = now + held if self._due is None else self._due + held
        # a late frame shortens the next action, but to no less than half
        self._due = max(due, now + held // 2)
        return True
