# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The edges and rows of polygons, cut to whole pixels as pygame's two polygon fillers cut them.

Everything here is integer (or single-precision) arithmetic that has to be repeated to the last
bit: `gfxdraw.aapolygon` and `gfxdraw.filled_polygon` are SDL_gfx's routines, `draw.polygon` is
pygame's own. Coordinates are those of the 1000x800 surface, y downwards.
"""

import numpy as np

from msgs_bridge.compiled import compiled

WIDTH = 1000
HEIGHT = 800
MAX_CORNERS = 8

# The columns of an edge record.
KIND = 0
X0 = 1
Y0 = 2
X_STEP = 3
STEPS = 4
SLOPE = 5
FIRST_X = 6
FIRST_Y = 7
LAST_Y = 8
EDGE_FIELDS = 9

# The kinds of an edge.
HIDDEN = 0
POINT_OR_VERTICAL = 1
HORIZONTAL = 2
STEEP = 3
SHALLOW = 4


@compiled
def clip_line(x1, y1, x2, y2):
    """
    Clip a line to the surface as SDL_gfx does, whole pixels and single precision included.

    A clipped end is moved along the line and cut to a whole pixel, and the ends may come back
    swapped; both change the line that is drawn.

    Returns:
        Whether anything shows, and the two ends.
    """
    right = WIDTH - 1
    bottom = HEIGHT - 1
    while True:
        code1 = (1 if x1 < 0 else (2 if x1 > right else 0)) | (
            8 if y1 < 0 else (4 if y1 > bottom else 0)
        )
        code2 = (1 if x2 < 0 else (2 if x2 > right else 0)) | (
            8 if y2 < 0 else (4 if y2 > bottom else 0)
        )
        if code1 | code2 == 0:
            return True, x1, y1, x2, y2
        if code1 & code2 != 0:
            return False, x1, y1, x2, y2
        if code1 == 0:
            x1, y1, x2, y2 = x2, y2, x1, y1
            code1 = code2
        slope = np.float32(1.0)
        if x2 != x1:
            slope = np.float32(np.float32(y2 - y1) / np.float32(x2 - x1))
        if code1 & 1:
            y1 += np.int64(np.float32(np.float32(0 - x1) * slope))
            x1 = 0
        elif code1 & 2:
            y1 += np.int64(np.float32(np.float32(right - x1) * slope))
            x1 = right
        elif code1 & 4:
            if x2 != x1:
                x1 += np.int64(np.float32(np.float32(bottom - y1) / slope))
            y1 = bottom
        else:
            if x2 != x1:
                x1 += np.int64(np.float32(np.float32(0 - y1) / slope))
            y1 = 0


@compiled
def describe_edge(x1, y1, x2, y2, edge):
    """
    Write one smoothed edge of a polygon, from its first corner to its second, into `edge`.

    The line advances `X_STEP` (or one row, if steep) per step, and by `SLOPE`/65536 of a pixel
    along the other axis. SDL_gfx draws its first pixel in full, its last one not at all, and
    each step between as two pixels that share the colour.
    """
    edge[KIND] = HIDDEN
    shows, x1, y1, x2, y2 = clip_line(x1, y1, x2, y2)
    if not shows:
        return
    edge[FIRST_X] = x1
    edge[FIRST_Y] = y1
    if y1 > y2:
        x1, y1, x2, y2 = x2, y2, x1, y1
    dx = x2 - x1
    dy = y2 - y1
    edge[X0] = x1
    edge[Y0] = y1
    edge[LAST_Y] = y2
    if dx == 0:
        edge[KIND] = POINT_OR_VERTICAL
        edge[X_STEP] = 0
        edge[STEPS] = dy
        return
    if dy == 0:
        edge[KIND] = HORIZONTAL
        edge[X0] = min(x1, x2)
        edge[STEPS] = abs(dx)
        return
    edge[X_STEP] = 1 if dx > 0 else -1
    dx = abs(dx)
    if dy > dx:
        edge[KIND] = STEEP
        edge[STEPS] = dy
        edge[SLOPE] = (dx << 16) // dy
    else:
        edge[KIND] = SHALLOW
        edge[STEPS] = dx
        edge[SLOPE] = (dy << 16) // dx


@compiled
def to_pixel(crossing, shift):
    """Round a crossing in 1/65536 as SDL_gfx's filler does; `shift` is 1 left, -1 right."""
    moved = crossing + shift
    return (moved >> 16) + ((moved & 32768) >> 15)


@compiled
def quad_rows(xs, ys, low, high, left, right, count):
    """
    Find what `gfxdraw.filled_polygon` fills of a quadrilateral in rows `low` to `high`.

    Args:
        xs: int (4,) corners.
        ys: int (4,) corners.
        low: First row wanted, at least the topmost corner's.
        high: Last row wanted, at most the lowest corner's.
        left: int32 (rows,), written: first pixel of each row.
        right: int32 (rows,), written: last pixel of each row.
        count: uint8 (rows,), scratch.

    Returns:
        Whether every row has exactly one run of pixels; if not, `left` and `right` are of no
        use and the rows have to be asked for one by one with `quad_row`.
    """
    lowest = max(max(ys[0], ys[1]), max(ys[2], ys[3]))
    for row in range(high - low + 1):
        count[row] = 0
    for i in range(4):
        j = (i + 3) & 3
        if ys[j] < ys[i]:
            x1, y1, x2, y2 = xs[j], ys[j], xs[i], ys[i]
        elif ys[j] > ys[i]:
            x1, y1, x2, y2 = xs[i], ys[i], xs[j], ys[j]
        else:
            continue
        start = max(y1, low)
        stop = min(y2 if y2 == lowest else y2 - 1, high)
        if start > stop:
            continue
        # floor(65536 * (y - y1) / dy) for each row in turn, without a division per row.
        dy = y2 - y1
        dx = x2 - x1
        whole = 65536 // dy
        part = 65536 - whole * dy
        scaled = 65536 * (start - y1)
        quotient = scaled // dy
        remainder = scaled - quotient * dy
        base = 65536 * x1
        for y in range(start, stop + 1):
            crossing = quotient * dx + base
            row = y - low
            if count[row] == 0:
                left[row] = crossing
                count[row] = 1
            else:
                right[row] = crossing
                count[row] += 1
            quotient += whole
            remainder += part
            if remainder >= dy:
                remainder -= dy
                quotient += 1
    simple = True
    for row in range(high - low + 1):
        simple &= count[row] == 2
        a = left[row]
        b = right[row]
        first = to_pixel(min(a, b), 1)
        last = to_pixel(max(a, b), -1)
        left[row] = min(first, last)
        right[row] = max(first, last)
    return simple


@compiled
def quad_row(xs, ys, y, runs):
    """
    Find what `gfxdraw.filled_polygon` fills of a quadrilateral in row `y`.

    Args:
        xs: int (4,) corners.
        ys: int (4,) corners.
        y: The row.
        runs: int64 (8,), written: first and last pixel of each run, in turn.

    Returns:
        How many runs there are: 0, 1 or 2.
    """
    lowest = max(max(ys[0], ys[1]), max(ys[2], ys[3]))
    found = 0
    for i in range(4):
        j = (i + 3) & 3
        if ys[j] < ys[i]:
            x1, y1, x2, y2 = xs[j], ys[j], xs[i], ys[i]
        elif ys[j] > ys[i]:
            x1, y1, x2, y2 = xs[i], ys[i], xs[j], ys[j]
        else:
            continue
        if (y1 <= y < y2) or (y == lowest and y1 < y <= y2):
            runs[found] = ((65536 * (y - y1)) // (y2 - y1)) * (x2 - x1) + 65536 * x1
            found += 1
    _sort(runs, found)
    for i in range(0, found - 1, 2):
        first = to_pixel(runs[i], 1)
        last = to_pixel(runs[i + 1], -1)
        runs[i] = min(first, last)
        runs[i + 1] = max(first, last)
    return found // 2


@compiled
def polygon_row(xs, ys, polygon, corners, top, lowest, y, runs):
    """
    Find what `draw.polygon` fills of a polygon in row `y`, its horizontal edges included.

    Args:
        xs: int64 (m, MAX_CORNERS): corners of all polygons.
        ys: int64 (m, MAX_CORNERS).
        polygon: Which of them.
        corners: How many corners it has.
        top: The row of its topmost corner.
        lowest: The row of its lowest corner.
        y: The row, between those two.
        runs: int64 (4 * MAX_CORNERS,), written: first and last pixel of each run, in turn.

    Returns:
        How many runs there are.
    """
    if top == lowest:
        runs[0] = runs[1] = xs[polygon, 0]
        for i in range(1, corners):
            runs[0] = min(runs[0], xs[polygon, i])
            runs[1] = max(runs[1], xs[polygon, i])
        return 1
    found = 0
    flat = 0
    before_x = xs[polygon, corners - 1]
    before_y = ys[polygon, corners - 1]
    for i in range(corners):
        x = xs[polygon, i]
        y_here = ys[polygon, i]
        if before_y < y_here:
            x1, y1, x2, y2 = before_x, before_y, x, y_here
        else:
            x1, y1, x2, y2 = x, y_here, before_x, before_y
        before_x = x
        before_y = y_here
        if y1 == y2:
            flat += y1 == y
        elif (y1 <= y < y2) or (y == lowest and y2 == lowest):
            offset = np.float32(np.float32((y - y1) * (x2 - x1)) / np.float32(y2 - y1))
            # pygame rounds the first, third, ... crossing that it finds down and the others up.
            if found % 2 == 0:
                offset = np.floor(offset)
            else:
                offset = np.ceil(offset)
            runs[found] = np.int64(offset) + x1
            found += 1
    _sort(runs, found)
    found -= found % 2
    if flat and top < y < lowest:
        for i in range(corners):
            k = i - 1 if i else corners - 1
            if ys[polygon, i] == y and ys[polygon, k] == y:
                runs[found] = min(xs[polygon, i], xs[polygon, k])
                runs[found + 1] = max(xs[polygon, i], xs[polygon, k])
                found += 2
    return found // 2


@compiled
def _sort(values, count):
    """Sort the first `count` numbers of `values`, of which there are few."""
    for i in range(1, count):
        value = values[i]
        k = i - 1
        while k >= 0 and values[k] > value:
            values[k + 1] = values[k]
            k -= 1
        values[k + 1] = value
