# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The renderers of the observation, and the choice between them."""

import numpy as np

from carracing_sim_node.simulation import Simulation

RENDERERS = ('auto', 'fast', 'stock')
"""Names that `make_env(renderer=...)` takes."""


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


def choose_renderer(name: str, sim: Simulation, *, settled_zoom: bool) -> StockRenderer:
    """
    Return the renderer called `name` for `sim`.

    Args:
        name: One of `RENDERERS`.
        sim: The simulation whose frames it will draw.
        settled_zoom: Draw the first second with the zoom that follows it.
    """
    if name == 'stock':
        return StockRenderer(sim, settled_zoom=settled_zoom)
    from carracing_sim_node.fast_renderer import FastRenderer

    return FastRenderer(sim, settled_zoom=settled_zoom)
