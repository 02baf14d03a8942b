"""The loops of registration that pay to be compiled; each has a numpy twin where it is used.

Plain loops over contiguous arrays, no fast-math. A look-up comes as its parts: ``tiles``,
``first``, ``pool`` and ``layout`` (x0, y0, cell); compiled code takes arrays, numbers and tuples.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.compiled import jit
from amr_slam.geometry import Array

Index = NDArray[np.int32]
Pool = NDArray[np.uint16]
Layout = tuple[float, float, float]

TILE: Final = 8
NONE: Final = 65535


@jit
def row_at(layer: int, iy: int, ix: int, tiles: Index, first: Index, pool: Pool) -> int:
    """The nearest point's row of a cell that lies inside the grid, or -1."""
    tile = tiles[layer, iy // TILE, ix // TILE]
    if tile < 0:
        return -1
    offset = pool[tile, iy % TILE, ix % TILE]
    if offset == NONE:
        return -1
    return int(first[tile]) + int(offset)


@jit
def layer_of(nx: float, ny: float) -> int:
    """The layer in which a wall with this normal looks for its like; 0 for no normal."""
    if nx == 0.0 and ny == 0.0:
        return 0
    if abs(nx) >= abs(ny):
        return 1 if nx > 0.0 else 3
    return 2 if ny > 0.0 else 4


@jit
def refine_lines(
    points: Array,
    normals: Array,
    poses: Array,
    target_points: Array,
    target_normals: Array,
    tiles: Index,
    first: Index,
    pool: Pool,
    layout: Layout,
    reach: float,
    agree: float,
    widths: Array,
    max_iterations: int,
    tolerance: float,
    variance: float,
    prior: Array,
    prior_information: Array,
) -> tuple[Array, Index, NDArray[np.bool_]]:
    """Gauss-Newton on point-to-line distances from each of k poses, see :mod:`icp`.

    Returns poses (k, 3), iterations (k,), converged (k,).
    """
    n, k = points.shape[0], poses.shape[0]
    ny, nx = tiles.shape[1] * TILE, tiles.shape[2] * TILE
    x0, y0, cell = layout
    out = poses.copy()
    iterations = np.zeros(k, dtype=np.int32)
    converged = np.zeros(k, dtype=np.bool_)
    reach2 = reach * reach
    for j in range(k):
        last = np.inf
        for iteration in range(max_iterations):
            width = widths[min(iteration, widths.shape[0] - 1)]
            x, y, theta = out[j, 0], out[j, 1], out[j, 2]
            c, s = math.cos(theta), math.sin(theta)
            hxx = hxy = hxt = hyy = hyt = htt = 0.0
            gx = gy = gt = 0.0
            for i in range(n):
                ax = c * points[i, 0] - s * points[i, 1]
                ay = s * points[i, 0] + c * points[i, 1]
                mx, my = ax + x, ay + y
                ix = math.floor((mx - x0) / cell)
                iy = math.floor((my - y0) / cell)
                if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
                    continue
                tx = c * normals[i, 0] - s * normals[i, 1]
                ty = s * normals[i, 0] + c * normals[i, 1]
                row = row_at(layer_of(tx, ty), iy, ix, tiles, first, pool)
                if row < 0:
                    continue
                qx, qy = target_normals[row, 0], target_normals[row, 1]
                if qx == 0.0 and qy == 0.0:
                    continue
                if (tx != 0.0 or ty != 0.0) and tx * qx + ty * qy < agree:
                    continue
                ex, ey = mx - target_points[row, 0], my - target_points[row, 1]
                if ex * ex + ey * ey > reach2:
                    continue
                residual = qx * ex + qy * ey
                fall = 1.0 + (residual / width) ** 2
                weight = 1.0 / (fall * fall)
                lever = qy * ax - qx * ay
                hxx += weight * qx * qx
                hxy += weight * qx * qy
                hxt += weight * qx * lever
                hyy += weight * qy * qy
                hyt += weight * qy * lever
                htt += weight * lever * lever
                gx += weight * residual * qx
                gy += weight * residual * qy
                gt += weight * residual * lever
            ox, oy = x - prior[0], y - prior[1]
            ot = (theta - prior[2] + math.pi) % (2.0 * math.pi) - math.pi
            p = prior_information
            # A little damping: a direction that nothing determines stays where it is.
            hxx = hxx / variance + p[0, 0] + 1.0
            hxy = hxy / variance + p[0, 1]
            hxt = hxt / variance + p[0, 2]
            hyy = hyy / variance + p[1, 1] + 1.0
            hyt = hyt / variance + p[1, 2]
            htt = htt / variance + p[2, 2] + 1.0
            gx = gx / variance + p[0, 0] * ox + p[0, 1] * oy + p[0, 2] * ot
            gy = gy / variance + p[0, 1] * ox + p[1, 1] * oy + p[1, 2] * ot
            gt = gt / variance + p[0, 2] * ox + p[1, 2] * oy + p[2, 2] * ot
            # The inverse of the symmetric 3 x 3 by its cofactors.
            axx = hyy * htt - hyt * hyt
            axy = hxt * hyt - hxy * htt
            axt = hxy * hyt - hxt * hyy
            ayy = hxx * htt - hxt * hxt
            ayt = hxy * hxt - hxx * hyt
            att = hxx * hyy - hxy * hxy
            determinant = hxx * axx + hxy * axy + hxt * axt
            # Beyond a metre or a radian the linearisation says nothing.
            sx = min(max(-(axx * gx + axy * gy + axt * gt) / determinant, -1.0), 1.0)
            sy = min(max(-(axy * gx + ayy * gy + ayt * gt) / determinant, -1.0), 1.0)
            st = min(max(-(axt * gx + ayt * gy + att * gt) / determinant, -1.0), 1.0)
            out[j, 0] = x + sx
            out[j, 1] = y + sy
            out[j, 2] = (theta + st + math.pi) % (2.0 * math.pi) - math.pi
            iterations[j] = iteration + 1
            last = max(abs(sx), abs(sy), abs(st))
            if last < tolerance and iteration + 1 >= widths.shape[0]:
                converged[j] = True
                break
        # Correspondences that flip to and fro keep a pose moving by millimetres: good enough.
        if last < 10.0 * tolerance:
            converged[j] = True
    return out, iterations, converged


@jit
def fit_scores(
    points: Array,
    weights: Array,
    poses: Array,
    target_points: Array,
    tiles: Index,
    first: Index,
    pool: Pool,
    free: NDArray[np.bool_],
    layout: Layout,
    scale: float,
    clear: float,
) -> Array:
    """(k,) weighted mean fit of the points at each of k poses: 1 on a wall, falling to 0 at
    ``scale``, and -1 in free space farther than ``clear`` from any wall."""
    n, k = points.shape[0], poses.shape[0]
    ny, nx = tiles.shape[1] * TILE, tiles.shape[2] * TILE
    x0, y0, cell = layout
    total = 0.0
    for i in range(n):
        total += weights[i]
    scores = np.zeros(k)
    for j in range(k):
        x, y, theta = poses[j, 0], poses[j, 1], poses[j, 2]
        c, s = math.cos(theta), math.sin(theta)
        score = 0.0
        for i in range(n):
            mx = c * points[i, 0] - s * points[i, 1] + x
            my = s * points[i, 0] + c * points[i, 1] + y
            ix = math.floor((mx - x0) / cell)
            iy = math.floor((my - y0) / cell)
            if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
                continue
            distance = np.inf
            row = row_at(0, iy, ix, tiles, first, pool)
            if row >= 0:
                distance = math.hypot(mx - target_points[row, 0], my - target_points[row, 1])
            if distance < scale:
                score += weights[i] * (1.0 - distance / scale)
            elif free[iy // 2, ix // 2] and distance > clear:
                score -= weights[i]
        scores[j] = score / total
    return scores


@jit
def cast_rays(
    origins: Array,
    directions: Array,
    range_max: float,
    target_points: Array,
    target_normals: Array,
    tiles: Index,
    first: Index,
    pool: Pool,
    layout: Layout,
    reach: float,
    hit: float,
) -> Array:
    """(n,) distance along each ray to the first wall it meets, inf beyond ``range_max``.

    Sphere tracing: no wall is nearer than the cell's nearest point, so a step of that length
    skips nothing. A wall is met within ``hit`` of one of its points.
    """
    ny, nx = tiles.shape[1] * TILE, tiles.shape[2] * TILE
    x0, y0, cell = layout
    out = np.full(origins.shape[0], np.inf)
    for i in range(origins.shape[0]):
        dx, dy = directions[i, 0], directions[i, 1]
        t = 0.0
        while t <= range_max:
            x, y = origins[i, 0] + t * dx, origins[i, 1] + t * dy
            ix = math.floor((x - x0) / cell)
            iy = math.floor((y - y0) / cell)
            if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
                t += cell
                continue
            row = row_at(0, iy, ix, tiles, first, pool)
            if row < 0:
                t += reach - cell
                continue
            ex, ey = target_points[row, 0] - x, target_points[row, 1] - y
            distance = math.hypot(ex, ey)
            if distance > hit:
                # The nearest of the cell's centre may be a little farther than the nearest here.
                t += max(distance - 0.75 * cell, 0.5 * hit)
                continue
            qx, qy = target_normals[row, 0], target_normals[row, 1]
            across = qx * dx + qy * dy
            ahead = ex * dx + ey * dy
            if abs(across) > 0.3:
                ahead = (qx * ex + qy * ey) / across
            out[i] = max(t + min(max(ahead, -hit), hit), 0.0)
            break
    return out


@jit
def distances(
    moved: Array,
    target_points: Array,
    tiles: Index,
    first: Index,
    pool: Pool,
    layout: Layout,
) -> Array:
    """(n,) from each point to the nearest wall, inf beyond reach: the least to the nearest of
    nine cells around it."""
    n = moved.shape[0]
    ny, nx = tiles.shape[1] * TILE, tiles.shape[2] * TILE
    x0, y0, cell = layout
    out = np.full(n, np.inf)
    for i in range(n):
        cx = math.floor((moved[i, 0] - x0) / cell)
        cy = math.floor((moved[i, 1] - y0) / cell)
        for iy in range(max(cy - 1, 0), min(cy + 2, ny)):
            for ix in range(max(cx - 1, 0), min(cx + 2, nx)):
                row = row_at(0, iy, ix, tiles, first, pool)
                if row >= 0:
                    d = math.hypot(
                        moved[i, 0] - target_points[row, 0], moved[i, 1] - target_points[row, 1]
                    )
                    out[i] = min(out[i], d)
    return out


@jit
def match_signatures(
    sections: NDArray[np.int64],
    ranges: NDArray[np.float32],
    places: NDArray[np.uint16],
    shorter: np.float32,
    longer: np.float32,
    unseen: np.float32,
) -> NDArray[np.float32]:
    """(m, s) mean cost of each place and rotation, see :func:`rdnm.match`.

    ``sections``, ``ranges`` (k,): the scan's seen sections; ``places`` (m, s): signatures in
    millimetres, 0 where the map knows nothing.
    """
    m, s = places.shape
    costs = np.zeros((m, s), dtype=np.float32)
    # Twice in a row, so that a rotation is an offset.
    twice = np.empty(2 * s, dtype=np.float32)
    for j in range(m):
        out = costs[j]
        for r in range(s):
            twice[r] = twice[r + s] = np.float32(1e-3) * np.float32(places[j, r])
        for k in range(sections.shape[0]):
            mine = ranges[k]
            # A slice starts anywhere without a test in the inner loop, which is so vectorised.
            turned = twice[sections[k] : sections[k] + s]
            for r in range(s):
                theirs = turned[r]
                cost = abs(min(max(mine - theirs, -shorter), longer))
                out[r] += unseen if theirs == np.float32(0.0) else cost
    costs /= np.float32(sections.shape[0])
    return costs


@jit
def sum_field(
    offsets: Index,
    values: NDArray[np.int8],
    rows: Index,
    columns: Index,
    headings: Index,
) -> NDArray[np.float32]:
    """(m,) sum of the field's values under a scan's points at each of m places and headings.

    ``values`` (ny, nx) in hundredths; ``offsets`` (h, n, 2) cells (row, column) from the robot
    to each point at each heading; the m hypotheses stand in cells ``rows``, ``columns`` with
    heading number ``headings``.
    """
    ny, nx = values.shape
    flat = values.ravel()
    out = np.zeros(rows.shape[0], dtype=np.float32)
    for j in range(rows.shape[0]):
        h = headings[j]
        total = 0
        for i in range(offsets.shape[1]):
            # Unsigned: what is left of or above the field is far right of or below it, too.
            iy = np.uint32(rows[j] + offsets[h, i, 0])
            ix = np.uint32(columns[j] + offsets[h, i, 1])
            if iy < ny and ix < nx:
                total += flat[iy * np.uint32(nx) + ix]
        out[j] = np.float32(0.01) * np.float32(total)
    return out
