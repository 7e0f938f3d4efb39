"""Loops over pixels, cells and profiles of terrain, compiled.

Points are (east, north, up) from the camera, metres, single precision, as planes of shape
(3, lines, samples). A square has four neighbouring pixels as corners and is marked at its upper
left one. The methods are described where the loops are called: `dtm.ground`, `dtm.heights`,
`dtm.occlusion`, `dtm.rover_body`, `insolation.horizon`, `orthophoto.panorama_grid`,
`mesh.point_cloud`, `mesh.right_triangles`.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.compiled import compiled

ONE, HALF = np.float32(1), np.float32(0.5)
NAN, TINY = np.float32(np.nan), np.float32(1e-6)
SPLITS = 4
"""Most repetitions of keeping the points above the mean: one sixteenth of them remains then."""

LEAST_WEIGHT = 1e-3
"""Weight of known cells up to which a position on a line of sight is unknown."""
LEAST_KNOWN = 0.5
"""Weight of known cells below which a value between cells counts as not known."""
SKY_M = 10_000.0
"""Range where no ground is seen."""
PENDING = np.float32(-1)
"""Error of a point that is still to be computed."""
SIGMA_STEP_M = np.float32(1e-5)
MOST_STEPS = 65535
CUBE_BITS = 21
"""Bits of a cube's number along an axis: a cloud is less than 2 million cubes wide."""
HASH = np.int64(-7046029254386353131)
"""2^64 over the golden ratio: multiplied by it, keys near each other are spread evenly."""

Lattice = tuple[int, int, np.float32, np.float32, np.float32]
"""The part of the map's lattice in a view: rows, columns, side of a cell in metres, and position of
the camera east and south of its outer upper left corner, in cells."""
LATTICE = ("int64", "int64", "float32", "float32", "float32")


@compiled("image", "points", "per_point", "per_point", "float32", "float32")
def points_of_pixels(
    parallax: np.ndarray,
    rotation: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
    focal_base: np.float32,
    radius_m: np.float32,
) -> np.ndarray:
    """Position of every pixel with a parallax; NaN elsewhere, and beyond the radius.

    Args:
        parallax: (lines, samples), pixels; NaN where there is none.
        rotation: (3, 3), from (right, down, forward) of the pair to (east, north, up).
        across: Right over forward, of every sample.
        down: Down over forward, of every line.
        focal_base: Focal length x base, pixel metres.
        radius_m: Farthest ground on the map.
    """
    lines, samples = parallax.shape
    planes = np.full((3, lines, samples), NAN)
    for y in range(lines):
        for x in range(samples):
            p = parallax[y, x]
            if np.isnan(p):
                continue
            depth = focal_base / p
            east = _along_ray(rotation[0], across[x], down[y]) * depth
            north = _along_ray(rotation[1], across[x], down[y]) * depth
            if east * east + north * north <= radius_m * radius_m:
                planes[0, y, x], planes[1, y, x] = east, north
                planes[2, y, x] = _along_ray(rotation[2], across[x], down[y]) * depth
    return planes


@compiled("image", "points", "points", "per_point", "per_point", "float32")
def pixels_in_box(
    parallax: np.ndarray,
    pose: np.ndarray,
    corners: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
    focal_base: np.float32,
) -> np.ndarray:
    """Pixels whose points are in a box.

    Args:
        parallax: (lines, samples), pixels; NaN where there is none.
        pose: (3, 4), rotation and translation from the pair to the box, metres.
        corners: (2, 3), least and largest coordinates of the box.
        across: Right over forward, of every sample.
        down: Down over forward, of every line.
        focal_base: Focal length x base, pixel metres.
    """
    lines, samples = parallax.shape
    inside = np.zeros((lines, samples), np.bool_)
    for y in range(lines):
        for x in range(samples):
            if parallax[y, x] > 0:
                depth = focal_base / parallax[y, x]
                inside[y, x] = True
                for axis in range(3):
                    right, below, ahead, origin = pose[axis]
                    place = (right * across[x] + below * down[y] + ahead) * depth + origin
                    inside[y, x] &= corners[0, axis] < place < corners[1, axis]
    return inside


@compiled()
def _along_ray(axis: np.ndarray, across: float, down: float) -> np.float32:
    """Component of a pixel's ray along an axis, over its forward component."""
    return np.float32(axis[0] * across + axis[1] * down + axis[2])


@compiled()
def _squared_m(planes: np.ndarray, y: int, x: int, across: int) -> np.float32:
    """Squared distance on the map from a pixel to the next one, across or down."""
    east = planes[0, y + 1 - across, x + across] - planes[0, y, x]
    north = planes[1, y + 1 - across, x + across] - planes[1, y, x]
    return east * east + north * north


@compiled("planes", "image", "float32", "float32")
def continuous_squares(
    planes: np.ndarray, parallax: np.ndarray, step_px: np.float32, gap_m: np.float32
) -> np.ndarray:
    """Squares whose sides all have steps of at most `step_px` of parallax and `gap_m` on the map.

    Marks of shape (lines, samples); the last line and sample have none.
    """
    lines, samples = parallax.shape
    farthest = gap_m * gap_m
    squares = np.zeros((lines, samples), np.bool_)
    down = np.zeros(samples, np.bool_)  # sides from the line above to this one
    along = np.zeros((2, samples), np.bool_)  # sides along these two
    for y in range(lines):
        for x in range(samples - 1):
            along[y % 2, x] = (
                abs(parallax[y, x + 1] - parallax[y, x]) <= step_px
                and _squared_m(planes, y, x, 1) <= farthest
            )
        if y == 0:
            continue
        for x in range(samples):
            down[x] = (
                abs(parallax[y, x] - parallax[y - 1, x]) <= step_px
                and _squared_m(planes, y - 1, x, 0) <= farthest
            )
        for x in range(samples - 1):
            squares[y - 1, x] = along[0, x] and along[1, x] and down[x] and down[x + 1]
    return squares


@compiled("planes", "mask")
def without_isolated(planes: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """The points that are a corner of some square; NaN elsewhere."""
    kept = np.full_like(planes, NAN)
    lines, samples = squares.shape
    for y in range(lines):
        for x in range(samples):
            if (
                squares[y, x]
                or (x and squares[y, x - 1])
                or (y and squares[y - 1, x])
                or (x and y and squares[y - 1, x - 1])
            ):
                for axis in range(3):
                    kept[axis, y, x] = planes[axis, y, x]
    return kept


@compiled()
def _cell(east: np.float32, north: np.float32, lattice: Lattice) -> int:
    """The cell of a point, counted along the rows of the lattice."""
    _, cols, side, camera_east, camera_south = lattice
    return int(camera_south - north / side) * cols + int(east / side + camera_east)


@compiled()
def _moments(values: np.ndarray, count: int) -> tuple[float, float]:
    """Mean and standard deviation of the first `count` values."""
    mean = variance = 0.0
    for k in range(count):
        mean += values[k]
    mean /= count
    for k in range(count):
        variance += (values[k] - mean) * (values[k] - mean)
    return mean, np.sqrt(variance / count)


@compiled("planes", "image", "image", LATTICE, "float32", "float64")
def upper_levels(
    planes: np.ndarray,
    parallax: np.ndarray,
    sigma_px: np.ndarray,
    lattice: Lattice,
    noise_px: np.float32,
    slope_m: float,
) -> np.ndarray:
    """The points in the upper level of every cell.

    Where heights scatter by more than twice the noise and the slope explain, only points above the
    mean are kept, repeatedly.

    Args:
        planes: Points of the view; NaN where there are none.
        parallax: Their parallax, pixels.
        sigma_px: Its standard deviation.
        lattice: The cells.
        noise_px: Standard deviation of parallax that scatter is compared with.
        slope_m: Scatter of a cell by the steepest slope, metres.

    Returns:
        (4, cells): count, mean and standard deviation of the heights of a cell (metres), and mean
        square of the standard deviations of parallax; 0 where there are no points.
    """
    _, lines, samples = planes.shape
    found = np.zeros((4, lattice[0] * lattice[1]))
    count, mean, scatter, square = found
    noise = np.zeros(count.size)
    cells = np.full((lines, samples), -1, np.int32)
    for y in range(lines):
        for x in range(samples):
            if np.isnan(planes[0, y, x]):
                continue
            cell = _cell(planes[0, y, x], planes[1, y, x], lattice)
            cells[y, x] = cell
            count[cell] += 1
            noise[cell] += noise_px / parallax[y, x] * abs(planes[2, y, x])
            square[cell] += sigma_px[y, x] * sigma_px[y, x]
    ends = np.cumsum(count).astype(np.int64)  # of each cell's heights, which are sorted by cell
    free = ends - count.astype(np.int64)
    heights = np.empty(ends[-1] if ends.size else 0, np.float32)
    for y in range(lines):
        for x in range(samples):
            cell = cells[y, x]
            if cell >= 0:
                heights[free[cell]] = planes[2, y, x]
                free[cell] += 1
    for cell in range(count.size):
        n = int(count[cell])
        if n == 0:
            continue
        square[cell] /= n
        own = heights[ends[cell] - n : ends[cell]]
        level, deviation = _moments(own, n)
        allowed = np.hypot(2 * noise[cell] / n, slope_m)
        for _ in range(SPLITS):
            if deviation <= allowed:
                break
            above = 0
            for k in range(n):
                if own[k] > level:
                    own[above] = own[k]
                    above += 1
            if above == 0:
                break
            n = above
            level, deviation = _moments(own, n)
        count[cell], mean[cell], scatter[cell] = n, level, deviation
    return found


@compiled("planes", "mask", "points", LATTICE, "float32")
def cells_of_mesh(
    planes: np.ndarray,
    squares: np.ndarray,
    measured: np.ndarray,
    lattice: Lattice,
    spacing_m: np.float32,
) -> np.ndarray:
    """The mesh in cells without points, by samples between the corners of squares.

    A square larger than `spacing_m` is divided into as many parts as its sides need, with a
    bilinear sample in the middle of each.

    Args:
        planes: Points of the view.
        squares: Squares of continuous ground.
        measured: (4, cells), as of `upper_levels`.
        lattice: The cells.
        spacing_m: Largest distance between samples.

    Returns:
        (3, cells): the number of samples, and the sums of their heights and of the length L t (1 -
        t) over which the ground between may deviate: L the distance of the lines, t the position
        between them; metres.
    """
    found = np.zeros((3, measured.shape[1]))
    lines, samples = squares.shape
    for y in range(lines - 1):
        for x in range(samples - 1):
            if not squares[y, x]:
                continue
            lines_m = np.sqrt(max(_squared_m(planes, y, x, 0), _squared_m(planes, y, x + 1, 0)))
            samples_m = np.sqrt(max(_squared_m(planes, y, x, 1), _squared_m(planes, y + 1, x, 1)))
            down = max(1, int(np.ceil(lines_m / spacing_m)))
            across = max(1, int(np.ceil(samples_m / spacing_m)))
            if down * across == 1:
                continue
            for i in range(down):
                t = (np.float32(i) + HALF) / np.float32(down)
                sag = lines_m * t * (ONE - t)
                for j in range(across):
                    s = (np.float32(j) + HALF) / np.float32(across)
                    east, north, up = (
                        _between(planes[0], y, x, s, t),
                        _between(planes[1], y, x, s, t),
                        _between(planes[2], y, x, s, t),
                    )
                    cell = _cell(east, north, lattice)
                    if measured[0, cell] == 0:
                        found[0, cell] += 1
                        found[1, cell] += up
                        found[2, cell] += sag
    return found


@compiled()
def _between(plane: np.ndarray, y: int, x: int, s: np.float32, t: np.float32) -> np.float32:
    """Value within a square, bilinear: `s` across and `t` down of its upper left corner."""
    upper = plane[y, x] + s * (plane[y, x + 1] - plane[y, x])
    lower = plane[y + 1, x] + s * (plane[y + 1, x + 1] - plane[y + 1, x])
    return upper + t * (lower - upper)


@compiled("indices", "indices", "per_point", ("int64", "int64"))
def places_in_fan(
    rows: np.ndarray, cols: np.ndarray, fan: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Index of every cell among the samples of profiles around a camera; -1 beyond them.

    Args:
        rows: Of the cells, and
        cols: their columns.
        fan: Position of the map's upper left corner east and north of the camera, and side of a
            cell, metres; first azimuth and their step, radians.
        size: Ranges and azimuths of the samples.
    """
    west, north, cell_m, first, step = fan
    ranges, azimuths = size
    found = np.full(len(rows), -1, np.int64)
    for k in range(len(rows)):
        x, y = west + (cols[k] + 0.5) * cell_m, north - (rows[k] + 0.5) * cell_m
        distance = int(np.hypot(x, y) / cell_m)
        turn = (np.arctan2(x, y) - first) % (2 * np.pi)
        azimuth = int(np.rint(turn / step))
        if distance < ranges and azimuth < azimuths:
            found[k] = distance * azimuths + azimuth
    return found


@compiled("image", "row", "row", "row", "float32", "float32")
def hidden_along(
    height: np.ndarray,
    distance_m: np.ndarray,
    tangent_beyond: np.ndarray,
    nearness_beyond: np.ndarray,
    line: np.float32,
    least_m: np.float32,
) -> tuple[np.ndarray, np.ndarray]:
    """Ground along profiles from a camera, supposed in gaps, and which of it is hidden.

    Args:
        height: (ranges, profiles), metres above the camera; NaN in gaps.
        distance_m: Of the ranges.
        tangent_beyond: Of the lowest ground beyond each profile; infinite where there is none.
        nearness_beyond: One over its distance, per metre.
        line: Tangent of a line of the image.
        least_m: Least distance below the camera of planes of visible ground.

    Returns:
        (ranges, profiles): the height, in gaps the lower one beside them, and whether ground there
        is hidden.
    """
    ranges, profiles = height.shape
    infinite = np.float32(np.inf)
    supposed = np.empty_like(height)
    highest = np.empty_like(height)  # tangent up to a distance
    reached = np.empty(height.shape, np.int32)  # where it was reached
    top, at = np.full(profiles, -infinite), np.zeros(profiles, np.int32)
    before = np.full(profiles, NAN)
    for r in range(ranges):
        for k in range(profiles):
            if not np.isnan(height[r, k]):
                before[k] = height[r, k]
                tangent = height[r, k] / distance_m[r]
                if tangent > top[k]:
                    top[k], at[k] = tangent, r
            supposed[r, k], highest[r, k], reached[r, k] = before[k], top[k], at[k]
    hidden = np.zeros(height.shape, np.bool_)
    after = np.full(profiles, NAN)
    above = np.maximum(tangent_beyond, top)  # the next higher tangent, and one over its distance
    nearness = nearness_beyond.copy()
    for r in range(ranges - 1, -1, -1):
        for k in range(profiles):
            known = not np.isnan(height[r, k])
            if known:
                after[k] = supposed[r, k]
            elif np.isnan(supposed[r, k]) or after[k] < supposed[r, k]:
                supposed[r, k] = after[k]
            tangent = highest[r, k]
            if not known:
                rise = max(above[k] - tangent, line)
                nearer = ONE / distance_m[reached[r, k]] - nearness[k]
                hidden[r, k] = (
                    supposed[r, k] / distance_m[r] < tangent - line
                    or rise / max(nearer, TINY) < least_m
                )
            if reached[r, k] == r and tangent > -infinite:
                above[k], nearness[k] = min(above[k], tangent), ONE / distance_m[r]
    return supposed, hidden


@compiled("image", "indices", "row")
def rise_along_lines(elevation: np.ndarray, whole: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Steepest rise per row from every cell to those above it along its line; 0 if none.

    Args:
        elevation: (rows, cols), metres; NaN where unknown.
        whole: Columns by which every row is moved so that lines are columns, rounded down.
        share: Remainders.

    Returns:
        (rows, cols), metres a row.
    """
    rows, cols = elevation.shape
    lines = whole.max() + cols + 1
    rise = np.zeros((lines, rows), np.float32)
    height = np.empty(rows, np.float32)
    beyond = np.empty(rows, np.int64)  # the row of the horizon: the hull's corners, near to far
    for line in range(lines):
        nearest = -1
        for row in range(rows):
            total = weight = np.float32(0)
            col = line - whole[row]
            if 0 <= col < cols and not np.isnan(elevation[row, col]):
                part = np.float32(1) - share[row]
                total, weight = total + elevation[row, col] * part, weight + part
            col -= 1
            if 0 <= col < cols and not np.isnan(elevation[row, col]):
                part = share[row]
                total, weight = total + elevation[row, col] * part, weight + part
            if weight <= LEAST_WEIGHT:
                continue
            here = total / weight
            height[row], beyond[row] = here, -1
            if nearest >= 0:
                corner = nearest
                slope = (height[corner] - here) / (row - corner)
                while beyond[corner] >= 0:
                    further = beyond[corner]
                    ahead = (height[further] - here) / (row - further)
                    if ahead < slope:
                        break
                    corner, slope = further, ahead
                rise[line, row], beyond[row] = slope, corner
            nearest = row
    found = np.empty((rows, cols), np.float32)
    for row in range(rows):
        for col in range(cols):
            one, other = rise[whole[row] + col, row], rise[whole[row] + col + 1, row]
            found[row, col] = one + share[row] * (other - one)
    return found


@compiled("points", "per_point")
def without_gaps(height: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Heights (rows, len(r)), gaps interpolated along each row over `r`; 0 in rows without any."""
    filled = np.zeros(height.shape)
    for row in range(len(height)):
        last = -1
        for k in range(len(r)):
            if np.isnan(height[row, k]):
                if last >= 0:
                    filled[row, k] = height[row, last]
                continue
            filled[row, k] = height[row, k]
            for gap in range(last + 1, k):
                filled[row, gap] = height[row, k]
                if last >= 0:
                    share = (r[gap] - r[last]) / (r[k] - r[last])
                    rise = height[row, k] - height[row, last]
                    filled[row, gap] = height[row, last] + share * rise
            last = k
    return filled


@compiled("points", "per_point", "per_point")
def first_hits(
    profiles: np.ndarray, r: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances at which profiles first reach elevation angles, and at which step.

    Args:
        profiles: (azimuths, len(r)), elevation angles of the ground, radians.
        r: Distances on the map, increasing, metres.
        angles: Decreasing, radians.

    Returns:
        (angles, azimuths): distances along the ray, metres, `SKY_M` where no ground is reached;
        indices of `r`, their number there.
    """
    count = len(r)
    found = np.empty((len(angles), len(profiles)))
    step = np.empty(found.shape, np.int64)
    for column in range(len(profiles)):
        profile, at, reached = profiles[column], 0, -np.inf
        for row in range(len(angles) - 1, -1, -1):
            angle = angles[row]
            while at < count and profile[at] < angle:
                reached = max(reached, profile[at])
                at += 1
            step[row, column] = at
            if at == count:
                found[row, column] = SKY_M
            elif at == 0:  # nearer than the first
                found[row, column] = abs(r[0] * np.tan(profile[0]) / min(np.sin(angle), -1e-9))
            else:
                rise = max(profile[at] - reached, 1e-12)
                share = min(max((angle - reached) / rise, 0.0), 1.0)
                distance = r[at - 1] + share * (r[at] - r[at - 1])
                found[row, column] = distance / max(np.cos(angle), 1e-9)
    return found, step


@compiled("image", "per_point", "per_point")
def values_between(values: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Values at rows and columns between cell centres, bilinear over known cells.

    NaN where these have at most `LEAST_KNOWN` of the weight, and beyond the cells.
    """
    lines, samples = values.shape
    found = np.full(len(rows), np.nan)
    for n in range(len(rows)):
        row, col = int(np.floor(rows[n])), int(np.floor(cols[n]))
        if not (-HALF <= rows[n] < lines - HALF and -HALF <= cols[n] < samples - HALF):
            continue
        down, right = rows[n] - row, cols[n] - col
        total = weight = 0.0
        for i in range(2):
            for j in range(2):
                value = values[min(max(row + i, 0), lines - 1), min(max(col + j, 0), samples - 1)]
                if not np.isnan(value):
                    share = (down if i else 1 - down) * (right if j else 1 - right)
                    total += share * value
                    weight += share
        if weight > LEAST_KNOWN:
            found[n] = total / weight
    return found


@compiled("points", "row", "float64")
def best_in_cubes(points: np.ndarray, sigma_m: np.ndarray, spacing_m: float) -> np.ndarray:
    """Indices of the most accurate points of all cubes, the first of equal ones, in their order.

    By a table of hashes with open addressing.

    Args:
        points: (n, 3), metres.
        sigma_m: Their standard deviations, compared in steps of `SIGMA_STEP_M`.
        spacing_m: Side of the cubes.
    """
    count = len(points)
    key, steps = np.empty(count, np.int64), np.empty(count, np.int32)
    for n in range(count):
        key[n] = 0
        for axis in range(3):
            cube = np.int64(np.floor(points[n, axis] / spacing_m))
            key[n] = key[n] << CUBE_BITS | cube & (1 << CUBE_BITS) - 1
        steps[n] = min(max(sigma_m[n] / SIGMA_STEP_M, 0), MOST_STEPS)
    size = 1
    while size < 2 * count:
        size *= 2
    table = np.full(size, -1, np.int32)
    slot = 0
    for n in range(count):
        if n == 0 or key[n] != key[n - 1]:
            slot = (key[n] * HASH >> 20) & (size - 1)
            while table[slot] >= 0 and key[table[slot]] != key[n]:
                slot = (slot + 1) & (size - 1)
        if table[slot] < 0 or steps[n] < steps[table[slot]]:
            table[slot] = n
    is_best = np.zeros(count, np.bool_)
    for slot in range(size):
        if table[slot] >= 0:
            is_best[table[slot]] = True
    return np.flatnonzero(is_best)


@compiled("image", "mask", "int64")
def errors_of_triangles(grid: np.ndarray, whole: np.ndarray, levels: int) -> np.ndarray:
    """The error of every point: exact, no less than its dependents', infinite next to holes.

    Args:
        grid: Values at the corners of squares.
        whole: Squares other than holes.
        levels: The root squares' side as a power of two.

    Returns:
        (rows, cols) of `grid`; 0 inside holes, and at the corners of root squares.
    """
    down, across = whole.shape
    known, unknown = _dependents(whole, levels), _dependents(~whole, levels)
    error = np.zeros_like(grid)
    for row in range(down + 1):
        for col in range(across + 1):
            if known[row, col]:
                error[row, col] = np.inf if unknown[row, col] else PENDING
    first, last = down, 0
    for row in range(down):
        if whole[row].any():
            first, last = min(first, row), row + 1
    surface, off = np.empty_like(grid), np.empty_like(grid)
    step, is_pending = 0, True
    while is_pending and step < 2 * levels:  # B_1, A_1, B_2, A_2, ...
        level, is_b = step // 2, step % 2 == 0
        half, side = 1 << level, 2 << level
        top, bottom = first // side * side, -(-last // side) * side
        surface[top : bottom + 1 : side, ::side] = grid[top : bottom + 1 : side, ::side]
        for finer in range(level, 0, -1):
            _interpolate(grid, surface, off, (top, bottom), 1 << finer, half if is_b else 0)
        if step == 0:
            _interpolate(grid, surface, off, (top, bottom), 1, 1)
        else:
            _interpolate_last(grid, surface, off, (top, bottom))
        for coarser in range(1, level + 1):
            _raise(off, (top, bottom), 1 << coarser)
        if is_b:
            is_pending = _take(error[::side, half::side], off[::side, half::side])
            is_pending |= _take(error[half::side, ::side], off[half::side, ::side])
        else:
            is_pending = _take(error[half::side, half::side], off[half::side, half::side])
        step += 1
    error[:: 1 << levels, :: 1 << levels] = 0
    for level in range(levels):
        _raise(error, (0, down), 1 << level)
    return error


@compiled()
def _dependents(squares: np.ndarray, levels: int) -> np.ndarray:
    """Points that depend on any of these squares."""
    down, across = squares.shape
    marked = np.zeros((down + 1, across + 1), np.uint8)
    for row in range(down):
        for below in range(2):
            for beside in range(2):
                for col in range(across):
                    marked[row + below, col + beside] |= squares[row, col]
    for level in range(levels):
        _raise(marked, (0, down), 1 << level)
    return marked


@compiled()
def _raise(values: np.ndarray, rows: tuple[int, int], half: int) -> None:
    """Raise middles and sides of squares of side 2 `half` to the points that depend on them."""
    first, last = rows
    cols, quarter = values.shape[1], half // 2
    if quarter:
        for row in range(first, last + 1, half):
            here = values[row]
            above = values[row - quarter if row > first else row + quarter]
            below = values[row + quarter if row < last else row - quarter]
            for col in range(half * (1 - row // half % 2), cols, 2 * half):
                left = abs(col - quarter)
                right = col + quarter if col + quarter < cols else left
                higher = max(above[left], above[right], below[left], below[right])
                here[col] = max(here[col], higher)
    for row in range(first + half, last, 2 * half):
        above, here, below = values[row - half], values[row], values[row + half]
        for col in range(half, cols, 2 * half):
            sides = max(above[col], below[col], here[col - half], here[col + half])
            here[col] = max(here[col], sides)


@compiled()
def _interpolate(
    grid: np.ndarray,
    surface: np.ndarray,
    off: np.ndarray,
    rows: tuple[int, int],
    half: int,
    exact: int,
) -> None:
    """Halve squares of side 2 `half` of the surface, and compare it with the grid.

    Where `half` is `exact`, the middles are those of the grid.
    """
    first, last = rows
    cols = grid.shape[1]
    for row in range(first, last + 1, 2 * half):
        for col in range(half, cols, 2 * half):
            mean = HALF * (surface[row, col - half] + surface[row, col + half])
            surface[row, col], off[row, col] = mean, abs(grid[row, col] - mean)
    for row in range(first + half, last, 2 * half):
        above, below = surface[row - half], surface[row + half]
        for col in range(0, cols, 2 * half):
            mean = HALF * (above[col] + below[col])
            surface[row, col], off[row, col] = mean, abs(grid[row, col] - mean)
        for col in range(half, cols, 2 * half):
            ends = above[col - half] + below[col + half]
            if not _falls(row // half, col // half):
                ends = above[col + half] + below[col - half]
            mean = grid[row, col] if half == exact else HALF * ends
            surface[row, col], off[row, col] = mean, abs(grid[row, col] - mean)


@compiled()
def _interpolate_last(
    grid: np.ndarray, surface: np.ndarray, off: np.ndarray, rows: tuple[int, int]
) -> None:
    """Compare squares of side 2 of the surface with the grid: the largest `off`, at the middle."""
    first, last = rows
    for row in range(first + 1, last, 2):
        upper, middle, lower = grid[row - 1], grid[row], grid[row + 1]
        above, below = surface[row - 1], surface[row + 1]
        for col in range(1, grid.shape[1], 2):
            nw, ne, sw, se = above[col - 1], above[col + 1], below[col - 1], below[col + 1]
            inside = abs(middle[col] - HALF * (nw + se if _falls(row, col) else ne + sw))
            across = max(abs(upper[col] - HALF * (nw + ne)), abs(lower[col] - HALF * (sw + se)))
            left, right = middle[col - 1] - HALF * (nw + sw), middle[col + 1] - HALF * (ne + se)
            off[row, col] = max(inside, across, abs(left), abs(right))


@compiled()
def _falls(row: int, col: int) -> bool:
    """Whether the diagonal of a square falls to the right; its middle, in halves of its side."""
    return (row // 2 + col // 2) % 2 == 0


@compiled()
def _take(error: np.ndarray, off: np.ndarray) -> bool:
    """Take the errors of pending points; whether there are any."""
    found = False
    for row in range(error.shape[0]):
        for col in range(error.shape[1]):
            if error[row, col] == PENDING:
                error[row, col], found = off[row, col], True
    return found
