# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""What our processes end with, besides 0."""
import signal

ERROR = 2
"""It could not be done; one line on stderr says why."""

INTERRUPTED = 128 + signal.SIGINT
"""Its user has stopped it."""

READER_GONE = 128 + signal.SIGPIPE
"""Nobody reads what it prints any more."""

FINISHED = 100
"""A node that a command of ours has started has done its work; with 0 any library may end it."""
