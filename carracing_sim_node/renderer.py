# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The renderers of the observation, and the choice between them."""

from typing import Protocol
import warnings

import numpy as np

from carracing_sim_node.errors import RendererUnavailableError
from carracing_sim_node.simulation import Simulation

RENDERERS = ('auto', 'fast', 'stock')
"""Names that `make_env(renderer=...)` takes."""


class RendererWarning(UserWarning):
    """The fast renderer cannot be used, and gymnasium's own code takes its place."""


class Renderer(Protocol):
    """Draws the observation of one simulation."""

    name: str

    def draw(self) -> np.ndarray:
        """Return the present frame, uint8 (96, 96, 3)."""


class StockRenderer:
    """Gymnasium's own drawing."""

    name = 'stock'

    def __init__(self, sim: Simulation, *, settled_zoom: bool) -> None:
        """Draw the frames of `sim`; with `settled_zoom` without the first second's zoom."""
        self._sim = sim
        self._settled_zoom = settled_zoom

    def draw(self) -> np.ndarray:
        """Return the present frame, uint8 (96, 96, 3)."""
        return self._sim.draw_stock(settled_zoom=self._settled_zoom)


def build(name: str, *, domain_randomize: bool, settled_zoom: bool) -> tuple[Simulation, Renderer]:
    """
    Create a simulation and the renderer called `name` for it.

    Args:
        name: One of `RENDERERS`.
        domain_randomize: Gymnasium's variant of that name.
        settled_zoom: Draw the first second with the zoom that follows it.

    Raises:
        RendererUnavailableError: If `name` is `fast` and the fast renderer cannot run, or does
            not draw what gymnasium draws.
    """
    obstacle = '' if name == 'stock' else _obstacle()
    if obstacle:
        if name == 'fast':
            raise RendererUnavailableError(f'{obstacle}; use the renderer auto or stock')
        warnings.warn(
            f"{obstacle}; using gymnasium's own code, which is much slower",
            RendererWarning,
            stacklevel=3,
        )
    if name == 'stock' or obstacle:
        sim = Simulation(domain_randomize=domain_randomize, own_code=False)
        return sim, StockRenderer(sim, settled_zoom=settled_zoom)
    from carracing_sim_node.fast_renderer import FastRenderer

    sim = Simulation(domain_randomize=domain_randomize)
    return sim, FastRenderer(sim, settled_zoom=settled_zoom)


def _obstacle() -> str:
    """Return why the fast renderer cannot be used here, or an empty string if it can."""
    try:
        # Imported here because it needs Numba, which an installation may lack.
        from carracing_sim_node import guard
    except ImportError as error:
        return f'the fast renderer needs Numba ({error})'
    return guard.difference()
