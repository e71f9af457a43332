# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""Running what somebody else wrote, so that what fails in it is known to be theirs."""
from __future__ import annotations

from collections.abc import Iterator
import contextlib
from pathlib import Path
import traceback

from msgs_bridge.errors import BridgeError
from msgs_bridge.plain_text import plain


@contextlib.contextmanager
def blamed(whose: str, what: str, kind: type[BridgeError]) -> Iterator[None]:
    """
    Let somebody's code do something; what it raises by accident becomes one line with the place.

    Args:
        whose: in words, such as a simulator and its name.
        what: it does: the name of a method.
        kind: what is raised then.

    Raises:
        BridgeError: one that was raised on purpose, or one of that kind.
    """
    try:
        yield
    except BridgeError:
        raise
    except (Exception, SystemExit) as error:
        # a library's exit would end the process with any code, 0 for one
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise kind(
            f'{whose} failed in {what}: {type(error).__name__}: {plain(error)} '
            f'({Path(place.filename).name}, line {place.lineno})') from error
