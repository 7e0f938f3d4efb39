"""Inner loops of matching, compiled: cubic B-splines, windows and their least squares.

Images are single precision, lines by samples. Positions are (sample, line) in pixels; (0, 0) is the
middle of the first pixel. Beyond its borders an image is mirrored about its outermost pixels.

**Values between pixels.** With the spline coefficients c of a row, c * (1, 4, 1)/6 = I, the value
at x = i + f, 0 <= f < 1, is (Unser 1999)

    I(x) = w0 c[i-1] + w1 c[i] + w2 c[i+1] + w3 c[i+2],
    w0 = (1-f)^3 / 6,  w1 = 2/3 - f^2 + f^3 / 2,  w2 = 1 - w0 - w1 - w3,  w3 = f^3 / 6.

**Least squares in windows.** Means over the window are subtracted from the grey values and from the
columns of the design matrix, which eliminates an unknown brightness; an unknown contrast k of the
right window R against the left one L is k = sum L R / sum R R.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.compiled import compiled

ONE = np.float32(1)
SIXTH = np.float32(1 / 6)
TWO_THIRDS = np.float32(2 / 3)

Weights = tuple[np.float32, np.float32, np.float32, np.float32]

TINY = 1e-12
"""Energy of a window treated as zero."""


@compiled()
def _spline_weights(f: np.float32) -> Weights:
    """Weights of the four coefficients about a position; `f` is its fraction of a pixel."""
    rest, square = ONE - f, f * f
    w0, w3 = rest * rest * rest * SIXTH, square * f * SIXTH
    w1 = TWO_THIRDS - square + 3 * w3
    return w0, w1, ONE - w0 - w1 - w3, w3


@compiled()
def _mirror(index: int, size: int) -> int:
    """The pixel at which a row of `size` pixels, mirrored beyond its ends, is read."""
    while index < 0 or index >= size:
        index = -index if index < 0 else 2 * size - 2 - index
    return index


@compiled()
def _between(row: np.ndarray, i: int, w: Weights) -> np.float32:
    """Grey value between the pixels `i` and `i + 1` of a row of spline coefficients."""
    n = len(row)
    if 1 <= i < n - 2:
        return w[0] * row[i - 1] + w[1] * row[i] + w[2] * row[i + 1] + w[3] * row[i + 2]
    return (
        w[0] * row[_mirror(i - 1, n)]
        + w[1] * row[_mirror(i, n)]
        + w[2] * row[_mirror(i + 1, n)]
        + w[3] * row[_mirror(i + 2, n)]
    )


@compiled()
def _value_in_row(row: np.ndarray, x: float) -> np.float32:
    """Grey value at sample `x` of a row of spline coefficients."""
    left = np.floor(x)
    return _between(row, int(left), _spline_weights(np.float32(x - left)))


@compiled("image", "image", "image")
def sample_points(coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey values at samples `x` and lines `y`, from the spline coefficients of both directions."""
    lines = coefficients.shape[0]
    values = np.empty_like(x)
    for r in range(x.shape[0]):
        for k in range(x.shape[1]):
            left, above = np.floor(x[r, k]), np.floor(y[r, k])
            i, j = int(left), int(above)
            a, b = _spline_weights(x[r, k] - left), _spline_weights(y[r, k] - above)
            if 1 <= j < lines - 2:
                values[r, k] = (
                    b[0] * _between(coefficients[j - 1], i, a)
                    + b[1] * _between(coefficients[j], i, a)
                    + b[2] * _between(coefficients[j + 1], i, a)
                    + b[3] * _between(coefficients[j + 2], i, a)
                )
            else:
                values[r, k] = (
                    b[0] * _between(coefficients[_mirror(j - 1, lines)], i, a)
                    + b[1] * _between(coefficients[_mirror(j, lines)], i, a)
                    + b[2] * _between(coefficients[_mirror(j + 1, lines)], i, a)
                    + b[3] * _between(coefficients[_mirror(j + 2, lines)], i, a)
                )
    return values


@compiled("image", "image", "image")
def parallax_residual(
    coefficients: np.ndarray, left: np.ndarray, parallax: np.ndarray
) -> np.ndarray:
    """R(x - p, y) - L(x, y) from row coefficients of the right image; 0 where p is NaN."""
    residual = np.empty_like(left)
    for y in range(left.shape[0]):
        row = coefficients[y]
        for x in range(left.shape[1]):
            p = parallax[y, x]
            if np.isnan(p):
                residual[y, x] = 0
            else:
                residual[y, x] = _value_in_row(row, np.float32(x) - p) - left[y, x]
    return residual


@compiled()
def _centre(values: np.ndarray) -> None:
    """Subtract the mean."""
    mean = values.mean()
    for k in range(len(values)):
        values[k] -= mean


@compiled(reorder_sums=True)
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products."""
    total = a[0] * b[0]
    for k in range(1, len(a)):
        total += a[k] * b[k]
    return total


@compiled()
def _inverse(a: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix of three rows, by its cofactors."""
    c = np.empty((3, 3))
    c[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c[0, 1] = c[1, 0] = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c[0, 2] = c[2, 0] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    c[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    c[1, 2] = c[2, 1] = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    return c / (a[0, 0] * c[0, 0] + a[0, 1] * c[0, 1] + a[0, 2] * c[0, 2])


@compiled(
    *("image", "image", "image", "pixels", "per_point"), ("int32", "int32", "float64", "float64")
)
def fit_parallax(
    left: np.ndarray,
    slope: np.ndarray,
    coefficients: np.ndarray,
    pixels: np.ndarray,
    start: np.ndarray,
    limits: tuple[int, int, float, float],
) -> np.ndarray:
    """Parallax p, linear over a window, brightness and contrast by least squares, point by point.

    L(x0 + dx, y0 + dy) + v = k0 + k1 R(x0 + dx - p - a dx - b dy, y0 + dy), the columns of the
    design matrix being -L_x (1, dx, dy).

    Args:
        left: The left image.
        slope: Its slope L_x along the row.
        coefficients: Row coefficients of the right image.
        pixels: Points whose windows are inside the left image.
        start: Approximate parallaxes.
        limits: Half side of the window, most steps, the step of p that ends them, and the largest
            movement of p.

    Returns:
        A row (p, a, b, residual variance v'v / (n - 5), N^-1_pp, correlation of the windows,
        whether p settled) for each point.
    """
    half, steps, settled_px, furthest_px = limits
    side = 2 * half + 1
    size = side * side
    out = np.empty((len(pixels), 7))
    grey, fitted, design = np.empty(size), np.empty(size), np.empty((3, size))
    normal, step = np.empty((3, 3)), np.empty(3)
    for n in range(len(pixels)):
        x0, y0 = pixels[n]
        for k in range(size):
            dx, dy = k % side - half, k // side - half
            grey[k] = left[y0 + dy, x0 + dx]
            g = float(slope[y0 + dy, x0 + dx])
            design[0, k], design[1, k], design[2, k] = -g, -g * dx, -g * dy
        _centre(grey)
        for i in range(3):
            _centre(design[i])
        for i in range(3):
            for j in range(3):
                normal[i, j] = _dot(design[i], design[j])
        # a window without texture has an inverse, and a huge standard deviation
        stiffness = 1e-9 * (normal[0, 0] + normal[1, 1] + normal[2, 2]) + TINY
        for i in range(3):
            normal[i, i] += stiffness
        inverse = _inverse(normal)
        p, a, b = start[n], 0.0, 0.0
        settled = far = False
        for _ in range(steps):
            for k in range(size):
                dx, dy = k % side - half, k // side - half
                fitted[k] = _value_in_row(coefficients[y0 + dy], x0 + dx - p - a * dx - b * dy)
            _centre(fitted)
            fitted *= _dot(grey, fitted) / max(_dot(fitted, fitted), TINY)
            for i in range(3):
                step[i] = _dot(design[i], grey) - _dot(design[i], fitted)
            dp = _dot(inverse[0], step)
            p, a, b = p + dp, a + _dot(inverse[1], step), b + _dot(inverse[2], step)
            far = abs(p - start[n]) > furthest_px
            settled = abs(dp) < settled_px
            if settled or far:
                break
        energy = np.sqrt(_dot(grey, grey) * _dot(fitted, fitted))
        out[n, 0], out[n, 1], out[n, 2] = p, a, b
        out[n, 3] = ((grey - fitted) ** 2).sum() / (size - 5)
        out[n, 4] = inverse[0, 0]
        out[n, 5] = _dot(grey, fitted) / max(energy, TINY)
        out[n, 6] = settled and not far
    return out


@compiled("image", "image", "pixels", "points", ("int32", "int32"))
def fit_offsets(
    left: np.ndarray,
    coefficients: np.ndarray,
    pixels: np.ndarray,
    start: np.ndarray,
    limits: tuple[int, int],
) -> np.ndarray:
    """Shift (u, v) of windows of the left image in the right one, with contrast, by least squares.

    The columns of the design matrix are the slopes of the left image along and across the row.

    Args:
        left: The left image.
        coefficients: Spline coefficients of the right image, in both directions.
        pixels: Points whose windows are inside the left image.
        start: Approximate shifts (u, v).
        limits: Half side of the window, and number of steps.

    Returns:
        A row (u, v, du, dv) for each point: the shift, and the last step.
    """
    half, steps = limits
    side = 2 * half + 1
    size = side * side
    lines, samples = left.shape
    out = np.empty((len(pixels), 4))
    grey, along, down, right = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    rows = np.empty((side + 3, side), np.float32)
    for n in range(len(pixels)):
        x0, y0 = pixels[n]
        for k in range(size):
            x, y = x0 + k % side - half, y0 + k // side - half
            x1, x2 = max(x - 1, 0), min(x + 1, samples - 1)
            y1, y2 = max(y - 1, 0), min(y + 1, lines - 1)
            grey[k] = left[y, x]
            along[k] = (left[y, x2] - left[y, x1]) / (x2 - x1)
            down[k] = (left[y2, x] - left[y1, x]) / (y2 - y1)
        _centre(grey)
        _centre(along)
        _centre(down)
        uu, uv, vv = _dot(along, along) + 1e-6, _dot(along, down), _dot(down, down) + 1e-6
        u, v = start[n]
        du = dv = 0.0
        for _ in range(steps):
            left_of, above = np.floor(u), np.floor(v)
            a = _spline_weights(np.float32(u - left_of))
            b = _spline_weights(np.float32(v - above))
            i, j = x0 - half + int(left_of), y0 - half + int(above)
            for r in range(side + 3):
                row = coefficients[_mirror(j - 1 + r, lines)]
                for k in range(side):
                    rows[r, k] = _between(row, i + k, a)
            for r in range(side):
                for k in range(side):
                    right[r * side + k] = (
                        b[0] * rows[r, k]
                        + b[1] * rows[r + 1, k]
                        + b[2] * rows[r + 2, k]
                        + b[3] * rows[r + 3, k]
                    )
            _centre(right)
            contrast = _dot(grey, right) / max(_dot(right, right), TINY)
            f = _dot(along, grey) - contrast * _dot(along, right)
            g = _dot(down, grey) - contrast * _dot(down, right)
            determinant = uu * vv - uv * uv
            du = min(max((vv * f - uv * g) / determinant, -1.0), 1.0)
            dv = min(max((uu * g - uv * f) / determinant, -1.0), 1.0)
            u, v = u + du, v + dv
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = u, v, du, dv
    return out


@compiled("windows", "points", "float64", "int32")
def fit_planes(
    offsets: np.ndarray, values: np.ndarray, least_deviation: float, steps: int
) -> np.ndarray:
    """Planes a + b x + c y of least absolute deviations through the neighbours of each point.

    By least squares, repeated with the weights 1 / max(|residual|, `least_deviation`), whose sum is
    1. A small regularisation keeps the plane of neighbours on one line level across it.

    Args:
        offsets: (n, k, 2): places of the neighbours from the point.
        values: (n, k): values there.
        least_deviation: Deviations below this have equal weight.
        steps: Reweightings.

    Returns:
        A row (a, residuals of the k neighbours) for each point; a is the value at the point.
    """
    count = values.shape[1]
    out = np.empty((len(values), 1 + count))
    design, weighted = np.ones((3, count)), np.empty(count)
    normal, right = np.empty((3, 3)), np.empty(3)
    for n in range(len(values)):
        value, residual = values[n], out[n, 1:]
        scale = np.abs(offsets[n]).mean() + 1e-9
        for k in range(count):
            design[1, k], design[2, k] = offsets[n, k, 0] / scale, offsets[n, k, 1] / scale
        residual[:] = value - np.median(value)
        for _ in range(steps):
            weight = 1.0 / np.maximum(np.abs(residual), least_deviation)
            weight /= weight.sum()
            for i in range(3):
                weighted[:] = weight * design[i]
                right[i] = _dot(weighted, value)
                for j in range(3):
                    normal[i, j] = _dot(weighted, design[j])
            normal[1, 1] += 0.05
            normal[2, 2] += 0.05
            inverse = _inverse(normal)
            a, b, c = _dot(inverse[0], right), _dot(inverse[1], right), _dot(inverse[2], right)
            residual[:] = value - a - b * design[1] - c * design[2]
            out[n, 0] = a
    return out


@compiled("image", "image", "indices", "indices")
def correlate(left: np.ndarray, right: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Correlations of the windows `left[a]` and `right[b]`, rows of mean 0 and length 1."""
    found = np.empty(len(a), np.float32)
    for n in range(len(a)):
        found[n] = _dot(left[a[n]], right[b[n]])
    return found


@compiled(reorder_sums=True)
def _add_along(row: np.ndarray, weights: np.ndarray, out: np.ndarray) -> None:
    """Weighted sums about the pixels of a row, 0 beyond its ends."""
    reach, n = len(weights) // 2, len(row)
    padded = np.zeros(n + 2 * reach, np.float32)
    padded[reach : reach + n] = row
    out[:] = 0
    for j in range(len(weights)):
        w = weights[j]
        for x in range(n):
            out[x] += w * padded[x + j]


@compiled(reorder_sums=True)
def _add_down(rows: np.ndarray, y: int, weights: np.ndarray, out: np.ndarray) -> None:
    """Weighted sums about the pixels of row `y`, 0 beyond the first and last row."""
    reach = len(weights) // 2
    out[:] = 0
    for j in range(max(0, reach - y), min(len(weights), len(rows) + reach - y)):
        w, row = weights[j], rows[y + j - reach]
        for x in range(len(out)):
            out[x] += w * row[x]


@compiled("image", "row", "row")
def window_sums(values: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Sums over the windows about all pixels, of pixels with the weight down[i] across[j]."""
    along, sums = np.empty_like(values), np.empty_like(values)
    for y in range(len(values)):
        _add_along(values[y], across, along[y])
    for y in range(len(values)):
        _add_down(along, y, down, sums[y])
    return sums


@compiled("image", "image", "image", "image", "image")
def least_squares_step(
    products: np.ndarray,
    residuals: np.ndarray,
    slopes: np.ndarray,
    count: np.ndarray,
    energy: np.ndarray,
) -> np.ndarray:
    """(sum g r - sum g sum r / n) / E of every window, from these sums, n and E; at most 1."""
    step = np.empty_like(products)
    for y in range(step.shape[0]):
        for x in range(step.shape[1]):
            along = products[y, x] - slopes[y, x] * residuals[y, x] / count[y, x]
            step[y, x] = min(max(along / energy[y, x], np.float32(-1)), ONE)
    return step


@compiled("image", "float32", "float32", "int32", reorder_sums=True)
def smooth_surfaces(
    parallax: np.ndarray, sigma_px: np.float32, edge_px: np.float32, radius: int
) -> np.ndarray:
    """Means over discs, with weights exp(-r^2 / 2 sigma^2) max(0, 1 - |difference| / edge).

    Differences are those of the parallax from that in the middle. NaN where there is no parallax,
    which has no weight.
    """
    lines, samples = parallax.shape
    smooth = np.empty_like(parallax)
    per_px = ONE / edge_px
    wide = np.full((lines + 2 * radius, samples + 2 * radius), np.float32(-1e9))
    for y in range(lines):
        for x in range(samples):
            if not np.isnan(parallax[y, x]):
                wide[y + radius, x + radius] = parallax[y, x]
    total, weight = np.empty(samples, np.float32), np.empty(samples, np.float32)
    for y in range(lines):
        middle = wide[y + radius, radius : radius + samples]
        total[:] = 0
        weight[:] = 0
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                if dx * dx + dy * dy > radius * radius:
                    continue
                nearness = np.float32(np.exp(-(dx * dx + dy * dy) / (2 * sigma_px * sigma_px)))
                start = radius + dx
                row = wide[y + radius + dy, start : start + samples]
                for x in range(samples):
                    difference = row[x] - middle[x]
                    w = nearness * max(ONE - per_px * abs(difference), np.float32(0))
                    weight[x] += w
                    total[x] += w * difference
        for x in range(samples):
            smooth[y, x] = parallax[y, x] + total[x] / weight[x]
    return smooth
