# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Draws the 96x96 observation without ever building gymnasium's 1000x800 surface.

The surface is made in bands of 100 rows, each of which shrinks to exactly twelve rows of the
observation and stays in the processor's cache meanwhile. While a band is drawn, `mixed` notes
which of its 12x96 windows may hold more than one colour; the others, most of the picture, need
no averaging at all.

Polygons are kept in the surface's coordinates before gymnasium flips it (y from the bottom of the
picture); rows of a band count from the top of the picture.
"""

from typing import NamedTuple

from gymnasium.envs.box2d.car_racing import MAX_SHAPE_DIM
import numpy as np

from msgs_bridge.compiled import compiled
from carracing_sim_node.edges import EDGE_FIELDS
from carracing_sim_node.edges import FIRST_X
from carracing_sim_node.edges import FIRST_Y
from carracing_sim_node.edges import HEIGHT
from carracing_sim_node.edges import HIDDEN
from carracing_sim_node.edges import HORIZONTAL
from carracing_sim_node.edges import KIND
from carracing_sim_node.edges import LAST_Y
from carracing_sim_node.edges import MAX_CORNERS
from carracing_sim_node.edges import POINT_OR_VERTICAL
from carracing_sim_node.edges import SLOPE
from carracing_sim_node.edges import STEEP
from carracing_sim_node.edges import STEPS
from carracing_sim_node.edges import WIDTH
from carracing_sim_node.edges import X0
from carracing_sim_node.edges import X_STEP
from carracing_sim_node.edges import Y0
from carracing_sim_node.edges import describe_edge
from carracing_sim_node.edges import polygon_row
from carracing_sim_node.edges import quad_row
from carracing_sim_node.edges import quad_rows
from carracing_sim_node.shrink_filter import shrink_tables

OUT = 96
BAND_ROWS = 100
BAND_OUT = BAND_ROWS * OUT // HEIGHT
BANDS = HEIGHT // BAND_ROWS

PANEL_ROWS = 100
"""Rows at the bottom of the picture that the black instrument panel covers entirely."""

PANEL_BANDS = PANEL_ROWS // BAND_ROWS

MAX_CAR_RUNS = 4096
"""
More runs of pixels than a car has: twelve polygons of at most 100 rows and mostly one run each.
"""

# The elements of a view.
COSINE = 0
SINE = 1
ZOOM = 2
SHIFT_X = 3
SHIFT_Y = 4
CAR_X = 5
CAR_Y = 6
VIEW_SIZE = 7

_FARTHEST_CORNER = 790.0
"""Pixels from the car, at (500, 200), to the farthest visible corner: 782, and some to spare."""

X_AXIS = shrink_tables(WIDTH, OUT)
Y_AXIS = shrink_tables(HEIGHT, OUT)
_X_FIRST = X_AXIS.first
_X_LAST = X_AXIS.last
_X_FIRST_WEIGHT = X_AXIS.first_weight
_X_LAST_WEIGHT = X_AXIS.last_weight
_X_LOW = X_AXIS.window_low
_X_HIGH = X_AXIS.window_high
_X_RECIPROCAL = X_AXIS.reciprocal
_Y_FIRST = Y_AXIS.first
_Y_LAST = Y_AXIS.last
_Y_FIRST_WEIGHT = Y_AXIS.first_weight
_Y_LAST_WEIGHT = Y_AXIS.last_weight
_Y_RECIPROCAL = Y_AXIS.reciprocal
_FLAT = Y_AXIS.flat[X_AXIS.flat]

# The first and last row of each output row of a band, and the first and last output row to which
# each row of a band adds: the same for every band.
_GROUP_FIRST = Y_AXIS.first[:BAND_OUT]
_GROUP_LAST = Y_AXIS.last[:BAND_OUT]
_ROW_LOW = Y_AXIS.window_low[:BAND_ROWS]
_ROW_HIGH = Y_AXIS.window_high[:BAND_ROWS]


class Scratch(NamedTuple):
    """Arrays that one renderer uses for every frame; `capacity` is for that many quads."""

    corners_x: np.ndarray
    """int64 (capacity, 4): whole-pixel corners of the quads that show."""

    corners_y: np.ndarray
    """int64 (capacity, 4)."""

    edges: np.ndarray
    """int64 (capacity, 4, EDGE_FIELDS)."""

    rows: np.ndarray
    """int64 (capacity, 4): lowest and highest visible row, place in `left`, one run per row."""

    rgb: np.ndarray
    """uint32 (capacity,): colours as 0xRRGGBB."""

    left: np.ndarray
    """int32 (capacity * visible rows,): first pixel of each row of each quad."""

    right: np.ndarray
    """int32 (capacity * visible rows,): last pixel of each row of each quad."""

    count: np.ndarray
    """uint8 (HEIGHT,)."""

    runs: np.ndarray
    """int64 (4 * MAX_CORNERS,)."""

    car_runs: np.ndarray
    """int64 (MAX_CAR_RUNS, 4): y, first pixel, last pixel and colour of the car's runs."""

    band: np.ndarray
    """uint32 (BAND_ROWS, WIDTH): the pixels of a band."""

    mixed: np.ndarray
    """uint8 (BAND_OUT, OUT): windows that may hold more than one colour."""


def make_scratch(capacity: int) -> Scratch:
    """Return the arrays for drawing up to `capacity` quads."""
    visible = HEIGHT - PANEL_ROWS
    return Scratch(
        corners_x=np.zeros((capacity, 4), np.int64),
        corners_y=np.zeros((capacity, 4), np.int64),
        edges=np.zeros((capacity, 4, EDGE_FIELDS), np.int64),
        rows=np.zeros((capacity, 4), np.int64),
        rgb=np.zeros(capacity, np.uint32),
        left=np.empty(capacity * visible, np.int32),
        right=np.empty(capacity * visible, np.int32),
        count=np.zeros(HEIGHT, np.uint8),
        runs=np.zeros(4 * MAX_CORNERS, np.int64),
        car_runs=np.zeros((MAX_CAR_RUNS, 4), np.int64),
        band=np.zeros((BAND_ROWS, WIDTH), np.uint32),
        mixed=np.zeros((BAND_OUT, OUT), np.uint8),
    )


@compiled
def mark(mixed, first_group, last_group, first_x, last_x):
    """Note that the windows around pixels `first_x` to `last_x` may hold several colours."""
    if last_x < 0 or first_x >= WIDTH:
        return
    low = _X_LOW[max(first_x, 0)]
    high = _X_HIGH[min(last_x, WIDTH - 1)]
    for group in range(first_group, last_group + 1):
        for column in range(low, high + 1):
            mixed[group, column] = 1


@compiled
def blend(pixel, rgb, weight):
    """
    Return `pixel` with `rgb` laid over it by `weight`/256 as SDL_gfx does it.

    SDL_gfx multiplies the colour's opacity of 255 by the weight first, which costs it 1.
    """
    alpha = np.uint32(255 * weight >> 8)
    rest = np.uint32(256) - alpha
    even = np.uint32(0x00FF00FF)
    green = np.uint32(0x0000FF00)
    rb = ((pixel & even) * rest + (rgb & even) * alpha) >> np.uint32(8) & even
    g = ((pixel & green) * rest + (rgb & green) * alpha) >> np.uint32(8) & green
    return rb | g


@compiled
def prepare_quads(quads, places, colours, view, with_field, scratch):
    """
    Turn and cut to pixels every quad that shows.

    Args:
        quads: float64 (n, 4, 2): corners in the world, in drawing order.
        places: float64 (n, 3): centre and radius of each quad.
        colours: uint32 (n,): 0xRRGGBB.
        view: float64 (VIEW_SIZE,).
        with_field: The first quad is the field.
        scratch: Written: corners, edges, rows, colours, left, right of each quad that shows.

    Returns:
        How many quads show.
    """
    cosine = view[COSINE]
    sine = view[SINE]
    zoom = view[ZOOM]
    reach = _FARTHEST_CORNER / zoom
    shown = 0
    place = 0
    for i in range(quads.shape[0]):
        dx = places[i, 0] - view[CAR_X]
        dy = places[i, 1] - view[CAR_Y]
        near = reach + places[i, 2]
        if dx * dx + dy * dy > near * near:
            continue
        xs = scratch.corners_x[shown]
        ys = scratch.corners_y[shown]
        # Gymnasium leaves out what has no corner near the surface, except the field.
        drawn = with_field and i == 0
        for k in range(4):
            x = quads[i, k, 0]
            y = quads[i, k, 1]
            pixel_x = (cosine * x - sine * y) * zoom + view[SHIFT_X]
            pixel_y = (sine * x + cosine * y) * zoom + view[SHIFT_Y]
            xs[k] = np.int64(pixel_x)
            ys[k] = np.int64(pixel_y)
            drawn |= (
                -MAX_SHAPE_DIM <= pixel_x <= WIDTH + MAX_SHAPE_DIM
                and -MAX_SHAPE_DIM <= pixel_y <= HEIGHT + MAX_SHAPE_DIM
            )
        low = max(min(min(ys[0], ys[1]), min(ys[2], ys[3])), PANEL_ROWS)
        high = min(max(max(ys[0], ys[1]), max(ys[2], ys[3])), HEIGHT - 1)
        if (
            not drawn
            or low > high
            or min(min(xs[0], xs[1]), min(xs[2], xs[3])) >= WIDTH
            or max(max(xs[0], xs[1]), max(xs[2], xs[3])) < 0
        ):
            continue
        rows = high - low + 1
        simple = quad_rows(
            xs,
            ys,
            low,
            high,
            scratch.left[place : place + rows],
            scratch.right[place : place + rows],
            scratch.count,
        )
        for k in range(4):
            n = (k + 1) & 3
            describe_edge(xs[k], ys[k], xs[n], ys[n], scratch.edges[shown, k])
        scratch.rows[shown, 0] = low
        scratch.rows[shown, 1] = high
        scratch.rows[shown, 2] = place
        scratch.rows[shown, 3] = simple
        scratch.rgb[shown] = colours[i]
        place += rows
        shown += 1
    return shown


@compiled
def fill_run(band, row, first, last, rgb):
    """Colour the pixels `first` to `last` of a row, as far as they are on the surface."""
    # Unsigned, so that Numba need not provide for indices from the end: that would keep the
    # loop from being vectorised.
    start = np.uint64(max(first, 0))
    stop = np.uint64(max(min(last, WIDTH - 1) + 1, 0))
    y = np.uint64(row)
    for x in range(start, stop):
        band[y, x] = rgb


@compiled
def fill_simple_quad(band, mixed, left, right, shift, top, low, high, rgb):
    """Fill rows `low` to `high` of a quad with one run per row; see `draw_edge`."""
    for y in range(low, high + 1):
        place = np.uint64(shift + y)
        fill_run(band, top - y, left[place], right[place], rgb)

    for group in range(_ROW_LOW[top - high], _ROW_HIGH[top - low] + 1):
        # Rows of this group, as y: 9 of them, the ones at its ends shared with its neighbours.
        group_low = max(top - _GROUP_LAST[group], low)
        group_high = min(top - _GROUP_FIRST[group], high)
        min_left = max_left = left[shift + group_low]
        min_right = max_right = right[shift + group_low]
        for y in range(group_low + 1, group_high + 1):
            a = left[shift + y]
            b = right[shift + y]
            min_left = min(min_left, a)
            max_left = max(max_left, a)
            min_right = min(min_right, b)
            max_right = max(max_right, b)
        if group_high - group_low == 8:
            # Only windows that a boundary between two pixels runs through are mixed.
            if max_left > 0 and min_left < WIDTH:
                mark_between(mixed, group, min_left, max_left)
            if max_right >= 0 and min_right < WIDTH - 1:
                mark_between(mixed, group, min_right + 1, max_right + 1)
        else:
            mark(mixed, group, group, min_left, max_right)


@compiled
def mark_between(mixed, group, first, last):
    """Mark the windows with a pixel before `last` and one from `first` on."""
    low = _X_LOW[max(first, 0)]
    high = _X_HIGH[min(last - 1, WIDTH - 1)]
    for column in range(low, high + 1):
        mixed[group, column] = 1


@compiled
def fill_split_quad(band, mixed, xs, ys, runs, top, low, high, rgb):
    """Fill rows `low` to `high` of a quad that folds over itself."""
    for y in range(low, high + 1):
        found = quad_row(xs, ys, y, runs)
        row = top - y
        for i in range(found):
            fill_run(band, row, runs[2 * i], runs[2 * i + 1], rgb)
            mark(mixed, _ROW_LOW[row], _ROW_HIGH[row], runs[2 * i], runs[2 * i + 1])


@compiled
def draw_edge(band, mixed, edges, quad, side, left, right, shift, simple, top, rgb):
    """
    Draw one smoothed edge of a quad in the band whose first row is `top`.

    SDL_gfx draws the edges first and then fills. Here the filling has come first and pixels
    inside it are left alone, which gives the same picture.

    Args:
        band: uint32 (BAND_ROWS, WIDTH), changed.
        mixed: uint8 (BAND_OUT, OUT), changed.
        edges: int64 (capacity, 4, EDGE_FIELDS).
        quad: Which quad.
        side: Which of its edges.
        left: int32: first pixel of the quad's filling in row y at `left[shift + y]`.
        right: int32: last pixel of the filling.
        shift: See `left`.
        simple: Whether `left` and `right` hold the filling at all.
        top: First row of the band, as y.
        rgb: Colour.
    """
    kind = edges[quad, side, KIND]
    bottom = top - BAND_ROWS + 1
    y0 = edges[quad, side, Y0]
    if kind == HIDDEN or y0 > top or edges[quad, side, LAST_Y] < bottom:
        return
    x0 = edges[quad, side, X0]
    steps = edges[quad, side, STEPS]

    if kind == POINT_OR_VERTICAL:
        low = max(y0, bottom)
        high = min(y0 + steps, top)
        if low <= high:
            for y in range(low, high + 1):
                band[top - y, x0] = rgb
            mark(mixed, _ROW_LOW[top - high], _ROW_HIGH[top - low], x0, x0)
        return
    if kind == HORIZONTAL:
        if bottom <= y0 <= top:
            row = top - y0
            fill_run(band, row, x0, x0 + steps, rgb)
            mark(mixed, _ROW_LOW[row], _ROW_HIGH[row], x0, x0 + steps)
        return

    first_x = edges[quad, side, FIRST_X]
    first_y = edges[quad, side, FIRST_Y]
    if bottom <= first_y <= top:
        row = top - first_y
        band[row, first_x] = rgb
        mark(mixed, _ROW_LOW[row], _ROW_HIGH[row], first_x, first_x)

    slope = edges[quad, side, SLOPE]
    x_step = edges[quad, side, X_STEP]
    # Of the two pixels of a step one lies within the filling almost always, and the other about
    # every second time, which no processor predicts: the first is passed over by a branch, the
    # second takes part with a weight of 0.
    if kind == STEEP:
        first = max(1, bottom - y0)
        last = min(steps - 1, top - y0)
        second_inside = False
        if simple and first <= last:
            k = (first + last) >> 1
            x = x0 + x_step * ((k * slope >> 16) + 1)
            second_inside = left[shift + y0 + k] <= x <= right[shift + y0 + k]
        for k in range(first, last + 1):
            y = y0 + k
            row = np.uint64(top - y)
            place = np.uint64(shift + y)
            inner = left[place] if simple else WIDTH
            outer = right[place] if simple else -1
            position = k * slope
            weight = (position >> 8) & 255
            x = x0 + x_step * (position >> 16)
            if second_inside:
                likely, likely_weight = x + x_step, weight
                open_weight = 255 - weight
            else:
                likely, likely_weight = x, 255 - weight
                x += x_step
                open_weight = weight
            if likely < inner or likely > outer:
                column = np.uint64(likely)
                band[row, column] = blend(band[row, column], rgb, likely_weight)
            open_weight = open_weight if (x < inner) | (x > outer) else 0
            column = np.uint64(x)
            band[row, column] = blend(band[row, column], rgb, open_weight)
        if first <= last:
            for group in range(_ROW_LOW[top - y0 - last], _ROW_HIGH[top - y0 - first] + 1):
                a = max(first, top - _GROUP_LAST[group] - y0)
                b = min(last, top - _GROUP_FIRST[group] - y0)
                start = x0 + x_step * (a * slope >> 16)
                end = x0 + x_step * ((b * slope >> 16) + 1)
                mark(mixed, group, group, min(start, end), max(start, end))
        return

    first, last = steps_in_rows(slope, steps, bottom - 1 - y0, top - y0)
    upper_inside = False
    if simple and first <= last:
        k = (first + last) >> 1
        y = y0 + (k * slope >> 16) + 1
        x = x0 + x_step * k
        upper_inside = y <= top and left[shift + y] <= x <= right[shift + y]
    for k in range(first, last + 1):
        position = k * slope
        weight = (position >> 8) & 255
        y = y0 + (position >> 16)
        x = x0 + x_step * k
        column = np.uint64(x)
        if upper_inside:
            likely, likely_weight = y + 1, weight
            open_weight = 255 - weight
        else:
            likely, likely_weight = y, 255 - weight
            y += 1
            open_weight = weight
        if bottom <= likely <= top:
            place = np.uint64(shift + likely)
            if not simple or x < left[place] or x > right[place]:
                row = np.uint64(top - likely)
                band[row, column] = blend(band[row, column], rgb, likely_weight)
        if bottom <= y <= top:
            place = np.uint64(shift + y)
            row = np.uint64(top - y)
            inside = simple and (x >= left[place]) & (x <= right[place])
            open_weight = 0 if inside else open_weight
            band[row, column] = blend(band[row, column], rgb, open_weight)
    if first > last:
        return
    lowest = max(y0 + (first * slope >> 16), bottom)
    highest = min(y0 + (last * slope >> 16) + 1, top)
    for group in range(_ROW_LOW[top - highest], _ROW_HIGH[top - lowest] + 1):
        a, b = steps_in_rows(
            slope, steps, top - _GROUP_LAST[group] - 1 - y0, top - _GROUP_FIRST[group] - y0
        )
        if a <= b:
            start = x0 + x_step * a
            end = x0 + x_step * b
            mark(mixed, group, group, min(start, end), max(start, end))


@compiled
def steps_in_rows(slope, steps, low, high):
    """Return the first and last step of a shallow edge between rows `low` and `high` of it."""
    first = 1
    if low > 0:
        first = max(first, (low * 65536 + slope - 1) // slope)
    last = steps - 1
    if high < 0:
        return 1, 0
    return first, min(last, ((high + 1) * 65536 - 1) // slope)


@compiled
def list_car_runs(xs, ys, corners, colours, runs, car_runs):
    """
    List the runs of pixels that `draw.polygon` fills for the car, in drawing order.

    Args:
        xs: int64 (m, MAX_CORNERS): corners of the polygons.
        ys: int64 (m, MAX_CORNERS).
        corners: int64 (m,): how many corners each has; 0 hides it.
        colours: uint32 (m,).
        runs: int64 (4 * MAX_CORNERS,), scratch.
        car_runs: int64 (n, 4), written: y, first pixel, last pixel, colour.

    Returns:
        How many runs there are, and the lowest and highest y among them.
    """
    count = 0
    lowest = HEIGHT
    highest = -1
    for polygon in range(xs.shape[0]):
        if corners[polygon] == 0:
            continue
        low = high = ys[polygon, 0]
        for i in range(1, corners[polygon]):
            low = min(low, ys[polygon, i])
            high = max(high, ys[polygon, i])
        for y in range(low, high + 1):
            found = polygon_row(xs, ys, polygon, corners[polygon], low, high, y, runs)
            for i in range(found):
                if count < car_runs.shape[0]:
                    car_runs[count, 0] = y
                    car_runs[count, 1] = runs[2 * i]
                    car_runs[count, 2] = runs[2 * i + 1]
                    car_runs[count, 3] = colours[polygon]
                    count += 1
        lowest = min(lowest, low)
        highest = max(highest, high)
    return count, lowest, highest


@compiled
def draw_car(band, mixed, car_runs, count, top):
    """Draw the `count` runs of the car that lie in the band whose first row is `top`."""
    for i in range(count):
        row = top - car_runs[i, 0]
        if 0 <= row < BAND_ROWS:
            fill_run(band, row, car_runs[i, 1], car_runs[i, 2], np.uint32(car_runs[i, 3]))
            mark(mixed, _ROW_LOW[row], _ROW_HIGH[row], car_runs[i, 1], car_runs[i, 2])


@compiled
def draw_panel(band, mixed, bars, bar_colours, text, text_x, text_y, first_row):
    """
    Draw the bars and the score that lie in the band whose first row from the top is `first_row`.

    Args:
        band: uint32 (BAND_ROWS, WIDTH), changed.
        mixed: uint8 (BAND_OUT, OUT), changed.
        bars: int64 (n, 4): first and last pixel, first and last row from the top.
        bar_colours: uint32 (n,).
        text: uint32 (height, width): the score.
        text_x: First pixel of the score.
        text_y: First row of the score from the top.
        first_row: First row of the band from the top.
    """
    for i in range(bars.shape[0]):
        low = max(bars[i, 2], first_row) - first_row
        high = min(bars[i, 3], first_row + BAND_ROWS - 1) - first_row
        if low <= high:
            for row in range(low, high + 1):
                fill_run(band, row, bars[i, 0], bars[i, 1], bar_colours[i])
            mark(mixed, _ROW_LOW[low], _ROW_HIGH[high], bars[i, 0], bars[i, 1])
    low = max(text_y, first_row) - first_row
    high = min(text_y + text.shape[0], first_row + BAND_ROWS) - 1 - first_row
    if low <= high:
        for row in range(low, high + 1):
            for x in range(max(text_x, 0), min(text_x + text.shape[1], WIDTH)):
                band[row, x] = text[row + first_row - text_y, x - text_x]
        mark(mixed, _ROW_LOW[low], _ROW_HIGH[high], text_x, text_x + text.shape[1] - 1)


@compiled
def shrink_band(band, mixed, index, out):
    """
    Shrink the band `index` to its rows of `out`.

    Args:
        band: uint32 (BAND_ROWS, WIDTH).
        mixed: uint8 (BAND_OUT, OUT): windows that may hold more than one colour.
        index: Which band, from the top.
        out: uint8 (96, 96, 3), written.
    """
    # Unsigned 64-bit numbers throughout: Numba takes a mixture of signs for floating point.
    even = np.uint64(0x00FF00FF)
    middle = np.uint64(0x0000FF00)
    byte = np.uint64(0xFF)
    low16 = np.uint64(0xFFFF)
    one = np.uint64(1)
    n8 = np.uint64(8)
    n16 = np.uint64(16)
    x_reciprocal = np.uint64(_X_RECIPROCAL)
    y_reciprocal = np.uint64(_Y_RECIPROCAL)
    flat_of = np.uint32(0xFFFFFFFF)
    flat_r = np.uint8(0)
    flat_g = np.uint8(0)
    flat_b = np.uint8(0)
    for group in range(BAND_OUT):
        i = index * BAND_OUT + group
        first_row = _Y_FIRST[i] - index * BAND_ROWS
        last_row = _Y_LAST[i] - index * BAND_ROWS
        top_weight = np.uint64(4 * _Y_FIRST_WEIGHT[i])
        bottom_weight = np.uint64(4 * _Y_LAST_WEIGHT[i])
        for j in range(OUT):
            if not mixed[group, j]:
                pixel = band[last_row, _X_LAST[j]]
                if pixel != flat_of:
                    flat_of = pixel
                    flat_r = _FLAT[pixel >> np.uint32(16)]
                    flat_g = _FLAT[(pixel >> np.uint32(8)) & np.uint32(255)]
                    flat_b = _FLAT[pixel & np.uint32(255)]
                out[i, j, 0] = flat_r
                out[i, j, 1] = flat_g
                out[i, j, 2] = flat_b
                continue
            first = _X_FIRST[j]
            last = _X_LAST[j]
            first_weight = np.uint64(4 * _X_FIRST_WEIGHT[j])
            last_weight = np.uint64(4 * _X_LAST_WEIGHT[j])
            red = np.uint64(0)
            green = np.uint64(0)
            blue = np.uint64(0)
            start = np.uint64(first + 1)
            stop = np.uint64(last)
            for row in range(np.uint64(first_row), np.uint64(last_row + 1)):
                # Red and blue in one sum, green in the other; neither overflows its 16 bits.
                rb = np.uint64(0)
                g = np.uint64(0)
                for x in range(start, stop):
                    pixel = np.uint64(band[row, x])
                    rb += pixel & even
                    g += pixel & middle
                a = np.uint64(band[row, start - one])
                b = np.uint64(band[row, stop])
                r = (
                    (rb >> n16)
                    + ((a >> n16) * first_weight >> n16)
                    + ((b >> n16) * last_weight >> n16)
                )
                g = (
                    (g >> n8)
                    + (((a >> n8) & byte) * first_weight >> n16)
                    + (((b >> n8) & byte) * last_weight >> n16)
                )
                bl = (
                    (rb & low16)
                    + ((a & byte) * first_weight >> n16)
                    + ((b & byte) * last_weight >> n16)
                )
                r = r * x_reciprocal >> n16
                g = g * x_reciprocal >> n16
                bl = bl * x_reciprocal >> n16
                if row == first_row:
                    r = r * top_weight >> n16
                    g = g * top_weight >> n16
                    bl = bl * top_weight >> n16
                elif row == last_row:
                    r = r * bottom_weight >> n16
                    g = g * bottom_weight >> n16
                    bl = bl * bottom_weight >> n16
                red += r
                green += g
                blue += bl
            out[i, j, 0] = red * y_reciprocal >> n16
            out[i, j, 1] = green * y_reciprocal >> n16
            out[i, j, 2] = blue * y_reciprocal >> n16


@compiled
def draw_frame(
    quads,
    places,
    colours,
    view,
    background,
    field,
    car_x,
    car_y,
    car_corners,
    car_colours,
    bars,
    bar_colours,
    text,
    text_x,
    text_y,
    scratch,
    out,
):
    """
    Draw one observation.

    Args:
        quads: float64 (n, 4, 2): field, grass and road in the world, in drawing order.
        places: float64 (n, 3): centre and radius of each.
        colours: uint32 (n,): 0xRRGGBB.
        view: float64 (VIEW_SIZE,): how the world lies in the picture.
        background: 0xRRGGBB of the field.
        field: Half the width of the field; beyond it the picture is black.
        car_x: int64 (m, MAX_CORNERS): corners of the car's polygons, in drawing order.
        car_y: int64 (m, MAX_CORNERS).
        car_corners: int64 (m,): how many corners each has.
        car_colours: uint32 (m,).
        bars: int64 (k, 4): the panel's bars, see `draw_panel`.
        bar_colours: uint32 (k,).
        text: uint32 (height, width): the score.
        text_x: First pixel of the score.
        text_y: First row of the score from the top.
        scratch: Arrays to work in.
        out: uint8 (96, 96, 3), written.
    """
    reach = _FARTHEST_CORNER / view[ZOOM]
    if abs(view[CAR_X]) + reach < field and abs(view[CAR_Y]) + reach < field:
        # The field reaches beyond the picture on every side.
        ground = np.uint32(background)
        shown = prepare_quads(quads[1:], places[1:], colours[1:], view, False, scratch)
    else:
        ground = np.uint32(0)
        shown = prepare_quads(quads, places, colours, view, True, scratch)
    car_count, car_low, car_high = list_car_runs(
        car_x, car_y, car_corners, car_colours, scratch.runs, scratch.car_runs
    )
    band = scratch.band
    mixed = scratch.mixed
    edges = scratch.edges
    rows = scratch.rows
    left = scratch.left
    right = scratch.right
    for index in range(BANDS):
        mixed[:, :] = 0
        if index >= BANDS - PANEL_BANDS:
            band[:, :] = np.uint32(0)
        else:
            band[:, :] = ground
            top = HEIGHT - 1 - index * BAND_ROWS
            bottom = top - BAND_ROWS + 1
            for quad in range(shown):
                low = max(rows[quad, 0], bottom)
                high = min(rows[quad, 1], top)
                if low > high:
                    continue
                rgb = scratch.rgb[quad]
                shift = rows[quad, 2] - rows[quad, 0]
                simple = rows[quad, 3] != 0
                if simple:
                    fill_simple_quad(band, mixed, left, right, shift, top, low, high, rgb)
                for side in range(4):
                    draw_edge(band, mixed, edges, quad, side, left, right, shift, simple, top, rgb)
                if not simple:
                    xs = scratch.corners_x[quad]
                    ys = scratch.corners_y[quad]
                    fill_split_quad(band, mixed, xs, ys, scratch.runs, top, low, high, rgb)
            if bottom <= car_high and car_low <= top:
                draw_car(band, mixed, scratch.car_runs, car_count, top)
        draw_panel(band, mixed, bars, bar_colours, text, text_x, text_y, index * BAND_ROWS)
        shrink_band(band, mixed, index, out)
