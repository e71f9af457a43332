# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
Draws the 96x96 observation without ever building gymnasium's 1000x800 surface.

The surface is made in bands of 25 rows, each of which shrinks to exactly three rows of the
observation and stays in the processor's cache meanwhile. While a band is drawn, `mixed` notes which
of its 3x96 windows may hold more than one colour; the others, most of the picture, need no
averaging at all.

Polygons are kept in the surface's coordinates before gymnasium flips it (y from the bottom of the
picture); rows of a band count from the top of the picture.
"""

from typing import NamedTuple

from gymnasium.envs.box2d.car_racing import MAX_SHAPE_DIM
import numpy as np

from carracing_sim_node.compiled import compiled
from carracing_sim_node.edges import EDGE_FIELDS
from carracing_sim_node.edges import FIRST_X
from carracing_sim_node.edges import FIRST_Y
from carracing_sim_node.edges import HEIGHT
from carracing_sim_node.edges import HIDDEN
from carracing_sim_node.edges import HORIZONTAL
from carracing_sim_node.edges import KIND
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
BAND_ROWS = 25
BAND_OUT = 3
BANDS = HEIGHT // BAND_ROWS

PANEL_BANDS = 4
"""Bands at the bottom of the picture that the black instrument panel covers entirely."""

PANEL_ROWS = PANEL_BANDS * BAND_ROWS

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
def group_of(row):
    """Return the first of the three output rows of a band to which `row` adds."""
    return 0 if row <= 8 else (1 if row <= 16 else 2)


@compiled
def last_group_of(row):
    """Return the last of the three output rows of a band to which `row` adds."""
    return 0 if row <= 7 else (1 if row <= 15 else 2)


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
    for x in range(max(first, 0), min(last, WIDTH - 1) + 1):
        band[row, x] = rgb


@compiled
def fill_simple_quad(scratch, quad, top, low, high, rgb):
    """Fill rows `low` to `high` of a quad with one run per row; the band begins at `top`."""
    left = scratch.left
    right = scratch.right
    shift = scratch.rows[quad, 2] - scratch.rows[quad, 0]
    for y in range(low, high + 1):
        fill_run(scratch.band, top - y, left[shift + y], right[shift + y], rgb)

    for group in range(BAND_OUT):
        # Rows of this group, as y: 9 of them, the ones at its ends shared with its neighbours.
        group_low = max(top - 8 * (group + 1), low)
        group_high = min(top - 8 * group, high)
        if group_low > group_high:
            continue
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
                mark_between(scratch.mixed, group, min_left, max_left)
            if max_right >= 0 and min_right < WIDTH - 1:
                mark_between(scratch.mixed, group, min_right + 1, max_right + 1)
        else:
            mark(scratch.mixed, group, group, min_left, max_right)


@compiled
def mark_between(mixed, group, first, last):
    """Mark the windows with a pixel before `last` and one from `first` on."""
    low = _X_LOW[max(first, 0)]
    high = _X_HIGH[min(last - 1, WIDTH - 1)]
    for column in range(low, high + 1):
        mixed[group, column] = 1


@compiled
def fill_split_quad(scratch, quad, top, low, high, rgb):
    """Fill rows `low` to `high` of a quad that folds over itself."""
    runs = scratch.runs
    for y in range(low, high + 1):
        found = quad_row(scratch.corners_x[quad], scratch.corners_y[quad], y, runs)
        row = top - y
        for i in range(found):
            fill_run(scratch.band, row, runs[2 * i], runs[2 * i + 1], rgb)
            # The neighbouring rows' groups as well: the run may end where this row does.
            mark(
                scratch.mixed,
                group_of(max(row - 1, 0)),
                last_group_of(min(row + 1, BAND_ROWS - 1)),
                runs[2 * i],
                runs[2 * i + 1],
            )


@compiled
def draw_edge(scratch, quad, edge, top, rgb):
    """
    Draw one smoothed edge of a quad in the band whose first row is `top`.

    SDL_gfx draws the edges first and then fills. Here the filling has come first and pixels
    inside it are left alone, which gives the same picture.
    """
    kind = edge[KIND]
    if kind == HIDDEN:
        return
    band = scratch.band
    mixed = scratch.mixed
    bottom = top - BAND_ROWS + 1
    x0 = edge[X0]
    y0 = edge[Y0]
    steps = edge[STEPS]

    if kind == POINT_OR_VERTICAL:
        low = max(y0, bottom)
        high = min(y0 + steps, top)
        if low <= high:
            for y in range(low, high + 1):
                band[top - y, x0] = rgb
            mark(mixed, group_of(top - high), last_group_of(top - low), x0, x0)
        return
    if kind == HORIZONTAL:
        if bottom <= y0 <= top:
            row = top - y0
            fill_run(band, row, x0, x0 + steps, rgb)
            mark(mixed, group_of(row), last_group_of(row), x0, x0 + steps)
        return

    if bottom <= edge[FIRST_Y] <= top:
        row = top - edge[FIRST_Y]
        band[row, edge[FIRST_X]] = rgb
        mark(mixed, group_of(row), last_group_of(row), edge[FIRST_X], edge[FIRST_X])

    slope = edge[SLOPE]
    x_step = edge[X_STEP]
    simple = scratch.rows[quad, 3]
    left = scratch.left
    right = scratch.right
    shift = scratch.rows[quad, 2] - scratch.rows[quad, 0]
    if kind == STEEP:
        first = max(1, bottom - y0)
        last = min(steps - 1, top - y0)
        for k in range(first, last + 1):
            y = y0 + k
            row = top - y
            position = k * slope
            x = x0 + x_step * (position >> 16)
            weight = (position >> 8) & 255
            inner = left[shift + y] if simple else WIDTH
            outer = right[shift + y] if simple else -1
            if x < inner or x > outer:
                band[row, x] = blend(band[row, x], rgb, 255 - weight)
            x += x_step
            if x < inner or x > outer:
                band[row, x] = blend(band[row, x], rgb, weight)
        for group in range(BAND_OUT):
            a = max(first, top - 8 * (group + 1) - y0)
            b = min(last, top - 8 * group - y0)
            if a <= b:
                start = x0 + x_step * (a * slope >> 16)
                end = x0 + x_step * ((b * slope >> 16) + 1)
                mark(mixed, group, group, min(start, end), max(start, end))
        return

    first, last = steps_in_rows(slope, steps, bottom - 1 - y0, top - y0)
    for k in range(first, last + 1):
        position = k * slope
        y = y0 + (position >> 16)
        x = x0 + x_step * k
        weight = (position >> 8) & 255
        if y >= bottom and (not simple or x < left[shift + y] or x > right[shift + y]):
            band[top - y, x] = blend(band[top - y, x], rgb, 255 - weight)
        y += 1
        if y <= top and (not simple or x < left[shift + y] or x > right[shift + y]):
            band[top - y, x] = blend(band[top - y, x], rgb, weight)
    for group in range(BAND_OUT):
        a, b = steps_in_rows(slope, steps, top - 8 * (group + 1) - 1 - y0, top - 8 * group - y0)
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
def draw_polygon(scratch, xs, ys, corners, rgb, top):
    """Fill, as `draw.polygon` does, what a polygon of the car has in the band from `top` on."""
    if corners == 0:
        return
    low = ys[0]
    high = ys[0]
    first = xs[0]
    last = xs[0]
    for i in range(1, corners):
        low = min(low, ys[i])
        high = max(high, ys[i])
        first = min(first, xs[i])
        last = max(last, xs[i])
    low = max(low, top - BAND_ROWS + 1)
    high = min(high, top)
    if low > high:
        return
    runs = scratch.runs
    for y in range(low, high + 1):
        for i in range(polygon_row(xs, ys, corners, y, runs)):
            fill_run(scratch.band, top - y, runs[2 * i], runs[2 * i + 1], rgb)
    mark(scratch.mixed, group_of(top - high), last_group_of(top - low), first, last)


@compiled
def draw_panel(scratch, bars, bar_colours, text, text_x, text_y, first_row):
    """
    Draw the bars and the score that lie in the band whose first row from the top is `first_row`.

    Args:
        scratch: The band.
        bars: int64 (n, 4): first and last pixel, first and last row from the top.
        bar_colours: uint32 (n,).
        text: uint32 (height, width): the score.
        text_x: First pixel of the score.
        text_y: First row of the score from the top.
        first_row: First row of the band from the top.
    """
    band = scratch.band
    mixed = scratch.mixed
    for i in range(bars.shape[0]):
        low = max(bars[i, 2], first_row) - first_row
        high = min(bars[i, 3], first_row + BAND_ROWS - 1) - first_row
        if low <= high:
            for row in range(low, high + 1):
                fill_run(band, row, bars[i, 0], bars[i, 1], bar_colours[i])
            mark(mixed, group_of(low), last_group_of(high), bars[i, 0], bars[i, 1])
    low = max(text_y, first_row) - first_row
    high = min(text_y + text.shape[0], first_row + BAND_ROWS) - 1 - first_row
    if low <= high:
        for row in range(low, high + 1):
            for x in range(max(text_x, 0), min(text_x + text.shape[1], WIDTH)):
                band[row, x] = text[row + first_row - text_y, x - text_x]
        mark(mixed, group_of(low), last_group_of(high), text_x, text_x + text.shape[1] - 1)


@compiled
def shrink_band(scratch, index, out):
    """
    Shrink the band `index` to rows 3 * index to 3 * index + 2 of `out`.

    Args:
        scratch: The band and its mixed windows.
        index: Which band, from the top.
        out: uint8 (96, 96, 3), written.
    """
    band = scratch.band
    mixed = scratch.mixed
    even = np.uint32(0x00FF00FF)
    flat_of = np.uint32(0xFFFFFFFF)
    flat_r = np.uint8(0)
    flat_g = np.uint8(0)
    flat_b = np.uint8(0)
    for group in range(BAND_OUT):
        i = index * BAND_OUT + group
        first_row = _Y_FIRST[i] - index * BAND_ROWS
        last_row = _Y_LAST[i] - index * BAND_ROWS
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
            first_weight = np.uint32(4 * _X_FIRST_WEIGHT[j])
            last_weight = np.uint32(4 * _X_LAST_WEIGHT[j])
            red = np.uint32(0)
            green = np.uint32(0)
            blue = np.uint32(0)
            for row in range(first_row, last_row + 1):
                rb = np.uint32(0)
                g = np.uint32(0)
                for x in range(first + 1, last):
                    pixel = band[row, x]
                    rb += pixel & even
                    g += (pixel >> np.uint32(8)) & np.uint32(255)
                a = band[row, first]
                b = band[row, last]
                r = (
                    (rb >> np.uint32(16))
                    + ((a >> np.uint32(16)) * first_weight >> np.uint32(16))
                    + ((b >> np.uint32(16)) * last_weight >> np.uint32(16))
                )
                g += (((a >> np.uint32(8)) & np.uint32(255)) * first_weight >> np.uint32(16)) + (
                    ((b >> np.uint32(8)) & np.uint32(255)) * last_weight >> np.uint32(16)
                )
                bl = (
                    (rb & np.uint32(0xFFFF))
                    + ((a & np.uint32(255)) * first_weight >> np.uint32(16))
                    + ((b & np.uint32(255)) * last_weight >> np.uint32(16))
                )
                r = r * np.uint32(_X_RECIPROCAL) >> np.uint32(16)
                g = g * np.uint32(_X_RECIPROCAL) >> np.uint32(16)
                bl = bl * np.uint32(_X_RECIPROCAL) >> np.uint32(16)
                if row == first_row:
                    weight = np.uint32(4 * _Y_FIRST_WEIGHT[i])
                    r = r * weight >> np.uint32(16)
                    g = g * weight >> np.uint32(16)
                    bl = bl * weight >> np.uint32(16)
                elif row == last_row:
                    weight = np.uint32(4 * _Y_LAST_WEIGHT[i])
                    r = r * weight >> np.uint32(16)
                    g = g * weight >> np.uint32(16)
                    bl = bl * weight >> np.uint32(16)
                red += r
                green += g
                blue += bl
            out[i, j, 0] = red * np.uint32(_Y_RECIPROCAL) >> np.uint32(16)
            out[i, j, 1] = green * np.uint32(_Y_RECIPROCAL) >> np.uint32(16)
            out[i, j, 2] = blue * np.uint32(_Y_RECIPROCAL) >> np.uint32(16)


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
    band = scratch.band
    mixed = scratch.mixed
    for index in range(BANDS):
        mixed[:, :] = 0
        if index >= BANDS - PANEL_BANDS:
            band[:, :] = np.uint32(0)
        else:
            band[:, :] = ground
            top = HEIGHT - 1 - index * BAND_ROWS
            bottom = top - BAND_ROWS + 1
            for quad in range(shown):
                low = max(scratch.rows[quad, 0], bottom)
                high = min(scratch.rows[quad, 1], top)
                if low > high:
                    continue
                rgb = scratch.rgb[quad]
                if scratch.rows[quad, 3]:
                    fill_simple_quad(scratch, quad, top, low, high, rgb)
                else:
                    # Folded quads are rare; they are drawn in SDL_gfx's own order.
                    for k in range(4):
                        draw_edge(scratch, quad, scratch.edges[quad, k], top, rgb)
                    fill_split_quad(scratch, quad, top, low, high, rgb)
                    continue
                for k in range(4):
                    draw_edge(scratch, quad, scratch.edges[quad, k], top, rgb)
            for i in range(car_x.shape[0]):
                draw_polygon(scratch, car_x[i], car_y[i], car_corners[i], car_colours[i], top)
        draw_panel(scratch, bars, bar_colours, text, text_x, text_y, index * BAND_ROWS)
        shrink_band(scratch, index, out)
