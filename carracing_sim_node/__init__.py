# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""CarRacing-v3, equal to gymnasium's to the byte and several times faster."""

from carracing_sim_node.environment import CarRacingEnvironment
from carracing_sim_node.environment import make_env
from carracing_sim_node.errors import EpisodeError
from carracing_sim_node.errors import InvalidActionError
from carracing_sim_node.errors import InvalidVariantError
from carracing_sim_node.errors import RendererUnavailableError
from carracing_sim_node.errors import SimulatorError
from carracing_sim_node.facts import Facts
from carracing_sim_node.renderer import RendererWarning

__all__ = [
    'CarRacingEnvironment',
    'EpisodeError',
    'Facts',
    'InvalidActionError',
    'InvalidVariantError',
    'RendererUnavailableError',
    'RendererWarning',
    'SimulatorError',
    'make_env',
]
