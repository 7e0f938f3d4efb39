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
TWO, THREE, FOUR = np.float32(2), np.float32(3), np.float32(4)
HALF, SIXTH = np.float32(0.5), np.float32(1 / 6)
TWO_THIRDS = np.float32(2 / 3)

U1, U2, U3 = np.uint64(1), np.uint64(2), np.uint64(3)

Window = tuple[np.ndarray, np.ndarray]
Weights = tuple[np.float32, np.float32, np.float32, np.float32]

TINY = 1e-12
"""Energy of a window treated as zero."""

UNKNOWNS = 8
"""Of an affine map: shift of two, change of shape of four, contrast and brightness."""

RIM = 2
"""Cells around a patch needed by slopes of fourth order."""

FAINT = 1e-9
"""Contrast treated as zero."""

OVER_RELAXATION = np.float32(1.7)
"""Factor of corrections of a membrane: with less, errors of long wavelengths take more sweeps."""

STIFFNESS = 1e-6
"""Relative addition to the diagonal, so that a patch without texture has a solution."""


@compiled()
def _spline_weights(f: np.float32) -> Weights:
    """Weights of the four coefficients about a position; `f` is its fraction of a pixel."""
    rest, square = ONE - f, f * f
    w0, w3 = rest * rest * rest * SIXTH, square * f * SIXTH
    w1 = TWO_THIRDS - square + THREE * w3
    return w0, w1, ONE - w0 - w1 - w3, w3


@compiled()
def _mirror(index: int, size: int) -> int:
    """The pixel at which a row of `size` pixels, mirrored beyond its ends, is read."""
    while index < 0 or index >= size:
        index = -index if index < 0 else 2 * size - 2 - index
    return index


@compiled()
def _four(row: np.ndarray, k: np.uint64, w: Weights) -> np.float32:
    """Weighted sum of four coefficients from `k` on, which has no sign: it is not from the end."""
    return w[0] * row[k] + w[1] * row[k + U1] + w[2] * row[k + U2] + w[3] * row[k + U3]


@compiled()
def _at_border(row: np.ndarray, i: int, w: Weights) -> np.float32:
    """Grey value between the pixels `i` and `i + 1` of a mirrored row of spline coefficients."""
    value = np.float32(0)
    for k in range(4):
        value += w[k] * row[_mirror(i - 1 + k, len(row))]
    return value


@compiled()
def _between(row: np.ndarray, i: int, w: Weights) -> np.float32:
    """Grey value between the pixels `i` and `i + 1` of a row of spline coefficients."""
    if 1 <= i < len(row) - 2:
        return _four(row, np.uint64(i - 1), w)
    return _at_border(row, i, w)


@compiled()
def _value_in_row(row: np.ndarray, x: float) -> np.float32:
    """Grey value at sample `x` of a row of spline coefficients."""
    left = np.floor(x)
    return _between(row, int(left), _spline_weights(np.float32(x - left)))


@compiled()
def _value_at_border(
    coefficients: np.ndarray, place: tuple[int, int], a: Weights, b: Weights
) -> np.float32:
    """Grey value right of and below a pixel of a mirrored image of spline coefficients."""
    value = np.float32(0)
    for k in range(4):
        row = coefficients[_mirror(place[1] - 1 + k, len(coefficients))]
        value += b[k] * _at_border(row, place[0], a)
    return value


@compiled()
def _value_at(coefficients: np.ndarray, x: float, y: float) -> np.float32:
    """Grey value at sample `x` and line `y` of an image of spline coefficients."""
    lines, samples = coefficients.shape
    left, above = np.floor(x), np.floor(y)
    i, j = int(left), int(above)
    a, b = _spline_weights(np.float32(x - left)), _spline_weights(np.float32(y - above))
    if not (1 <= i < samples - 2 and 1 <= j < lines - 2):
        return _value_at_border(coefficients, (i, j), a, b)
    k, row = np.uint64(i - 1), np.uint64(j - 1)
    return (
        b[0] * _four(coefficients[row], k, a)
        + b[1] * _four(coefficients[row + U1], k, a)
        + b[2] * _four(coefficients[row + U2], k, a)
        + b[3] * _four(coefficients[row + U3], k, a)
    )


@compiled("image", "image", "image")
def sample_points(coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey values at samples `x` and lines `y`, from the spline coefficients of both directions."""
    values = np.empty_like(x)
    for r in range(x.shape[0]):
        for k in range(x.shape[1]):
            values[r, k] = _value_at(coefficients, x[r, k], y[r, k])
    return values


@compiled("points", "points", "indices", "points", "indices")
def evaluate_bicubic(
    coefficients: np.ndarray,
    across: np.ndarray,
    first_across: np.ndarray,
    down: np.ndarray,
    first_down: np.ndarray,
) -> np.ndarray:
    """Values, in single precision, of a bicubic spline on the grid of given columns and rows.

    Args:
        coefficients: B-spline coefficients, rows by columns.
        across: The four B-splines that are not 0 at each column.
        first_across: Index of the first of them.
        down: The same at each row.
        first_down: The same.
    """
    values = np.empty((len(down), len(across)), np.float32)
    row = np.empty(coefficients.shape[1])
    for y in range(len(down)):
        row[:] = 0
        for m in range(4):
            row += down[y, m] * coefficients[first_down[y] + m]
        for x in range(len(across)):
            k = np.uint64(first_across[x])
            values[y, x] = (
                across[x, 0] * row[k]
                + across[x, 1] * row[k + U1]
                + across[x, 2] * row[k + U2]
                + across[x, 3] * row[k + U3]
            )
    return values


@compiled()
def _sample_row(row: np.ndarray, x: float, step: float, values: np.ndarray) -> None:
    """Grey values at the samples x, x + step, x + 2 step, ... of a row of spline coefficients."""
    last = x + (len(values) - 1) * step
    if min(x, last) < 1 or max(x, last) >= len(row) - 2:
        for k in range(len(values)):
            values[k] = _value_in_row(row, x + k * step)
    else:
        for k in range(len(values)):
            at = x + k * step
            i = np.uint32(at)
            values[k] = _four(row, np.uint64(i) - U1, _spline_weights(np.float32(at - i)))


@compiled("image", "image", "image")
def parallax_residual(
    coefficients: np.ndarray, left: np.ndarray, parallax: np.ndarray
) -> np.ndarray:
    """R(x - p, y) - L(x, y) from row coefficients of the right image; 0 where p is NaN.

    Beyond a pixel outside the right image its values are those there.
    """
    samples = left.shape[1]
    residual = np.empty_like(left)
    row = np.empty(samples + 5, np.float32)  # mirrored: two pixels before, three behind
    for y in range(left.shape[0]):
        row[2 : samples + 2] = coefficients[y]
        row[0], row[1] = coefficients[y, 2], coefficients[y, 1]
        for k in range(3):
            row[samples + 2 + k] = coefficients[y, samples - 2 - k]
        for x in range(samples):
            p = parallax[y, x]
            at = min(max(np.float32(x) - p, np.float32(-1)), np.float32(samples))
            known = p == p  # noqa: PLR0124 - not NaN
            at = at + TWO if known else TWO
            i = np.uint32(at)
            value = _four(row, np.uint64(i) - U1, _spline_weights(at - np.float32(i)))
            residual[y, x] = value - left[y, x] if known else np.float32(0)
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
        k = 0
        for dy in range(-half, half + 1):
            for dx in range(-half, half + 1):
                grey[k] = left[y0 + dy, x0 + dx]
                g = float(slope[y0 + dy, x0 + dx])
                design[0, k], design[1, k], design[2, k] = -g, -g * dx, -g * dy
                k += 1
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
            for r in range(side):
                dy = r - half
                x = x0 - half - p + a * half - b * dy
                _sample_row(coefficients[y0 + dy], x, 1 - a, fitted[r * side : (r + 1) * side])
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
            inside = 1 <= i < samples - side - 1
            for r in range(side + 3):
                row = coefficients[_mirror(j - 1 + r, lines)]
                for k in range(side):
                    if inside:
                        rows[r, k] = _four(row, np.uint64(i + k - 1), a)
                    else:
                        rows[r, k] = _at_border(row, i + k, a)
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


@compiled()
def _invert(a: np.ndarray) -> None:
    """Replace a positive definite matrix by its inverse (Gauss and Jordan)."""
    for k in range(len(a)):
        pivot = 1 / a[k, k]
        a[k, k] = 1.0
        a[k] *= pivot
        for i in range(len(a)):
            if i != k:
                factor = a[i, k]
                a[i, k] = 0.0
                a[i] -= factor * a[k]


@compiled()
def _draw_patch(
    search: np.ndarray, affine: np.ndarray, u: float, v: float, patch: np.ndarray
) -> None:
    """A search patch at A x + (u, v), less its mean within the rim; x, u, v from the middles."""
    size, side = search.shape[0], patch.shape[0]
    middle, half = (size - 1) / 2, side // 2
    total = 0.0
    for r in range(side):
        for c in range(side):
            x, y = c - half, r - half
            across = affine[0, 0] * x + affine[0, 1] * y + u + middle
            along = affine[1, 0] * x + affine[1, 1] * y + v + middle
            across = min(max(across, 1.0), size - 2.001)
            along = min(max(along, 1.0), size - 2.001)
            i, j = int(across), int(along)
            f, g = across - i, along - j
            upper = search[j, i] * (1 - f) + search[j, i + 1] * f
            lower = search[j + 1, i] * (1 - f) + search[j + 1, i + 1] * f
            patch[r, c] = upper * (1 - g) + lower * g
            if RIM <= r < side - RIM and RIM <= c < side - RIM:
                total += patch[r, c]
    patch -= total / (side - 2 * RIM) ** 2


@compiled()
def _affine_columns(patch: np.ndarray, design: np.ndarray) -> None:
    """Derivatives of a patch without its rim by shift, affine map, contrast and brightness."""
    side = patch.shape[0] - 2 * RIM
    half, k = side // 2, 0
    for r in range(RIM, RIM + side):
        for c in range(RIM, RIM + side):
            x, y = c - RIM - half, r - RIM - half
            near, far = patch[r, c + 1] - patch[r, c - 1], patch[r, c + 2] - patch[r, c - 2]
            along = (8 * near - far) / 12
            near, far = patch[r + 1, c] - patch[r - 1, c], patch[r + 2, c] - patch[r - 2, c]
            down = (8 * near - far) / 12
            design[0, k], design[1, k] = along, down
            design[2, k], design[3, k] = along * x, along * y
            design[4, k], design[5, k] = down * x, down * y
            design[6, k] = patch[r, c]
            k += 1


@compiled()
def correlated_neighbours(residual: np.ndarray, side: int) -> float:
    """Number of correlated neighbouring residuals that are equivalent to one.

    Smoothed and interpolated patches leave correlated residuals; for a first-order process (1 + r)
    / (1 - r) of them, along each axis, have the information of one.
    """
    power = max(_dot(residual, residual) / len(residual), 1e-12)
    along = down = 0.0
    for k in range(len(residual)):
        if k % side:
            along += residual[k] * residual[k - 1]
        if k >= side:
            down += residual[k] * residual[k - side]
    number = side * (side - 1) * power
    a, b = min(max(along / number, 0.0), 0.9), min(max(down / number, 0.0), 0.9)
    return (1 + a) / (1 - a) * (1 + b) / (1 - b)


@compiled("planes", "planes", "points", ("int32", "float64"))
def fit_affine(
    templates: np.ndarray, searches: np.ndarray, start: np.ndarray, limits: tuple[int, float]
) -> np.ndarray:
    """Affine maps of templates to wider search patches, with brightness and contrast.

    Args:
        templates: (n, a, a), a odd.
        searches: (n, b, b), b odd.
        start: (n, 2): approximate shifts by columns and rows.
        limits: Gauss-Newton steps; largest change of shape in one of them.

    Returns:
        A row (shift by columns and by rows, its sigma, affine matrix row by row, correlation,
        length of the last step) for each patch.
    """
    steps, stretch = limits
    side = templates.shape[1]
    size = side * side
    out = np.empty((len(templates), 9))
    design = np.ones((UNKNOWNS, size))
    patch = np.empty((side + 2 * RIM, side + 2 * RIM))
    template, rest = np.empty(size), np.empty(size)
    normal, scale, found = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    affine, change = np.empty((2, 2)), np.empty((2, 2))
    for n in range(len(templates)):
        for k in range(size):
            template[k] = templates[n, k // side, k % side]
        _centre(template)
        power = _dot(template, template)
        u, v = start[n]
        affine[:] = 0
        affine[0, 0] = affine[1, 1] = 1
        variance = last = 0.0
        for _ in range(steps):
            _draw_patch(searches[n], affine, u, v, patch)
            _affine_columns(patch, design)
            spread = np.sqrt(_dot(design[6], design[6]) / size)
            gain = np.sqrt(power / size) / max(spread, FAINT)
            design[:7] *= gain
            rest[:] = template - design[6]
            for i in range(UNKNOWNS):
                scale[i] = max(np.sqrt(_dot(design[i], design[i]) / size), FAINT)
            for i in range(UNKNOWNS):
                for j in range(i + 1):
                    normal[i, j] = _dot(design[i], design[j]) / (scale[i] * scale[j])
                    normal[j, i] = normal[i, j]
                normal[i, i] += STIFFNESS * size
            _invert(normal)
            found[:] = 0
            for j in range(UNKNOWNS):
                found += normal[j] * (_dot(design[j], rest) / scale[j])
            found /= scale
            for j in range(UNKNOWNS):
                rest -= found[j] * design[j]
            variance = (normal[0, 0] / scale[0] ** 2 + normal[1, 1] / scale[1] ** 2) / 2
            e, f = min(max(found[0], -1.0), 1.0), min(max(found[1], -1.0), 1.0)
            du, dv = affine[0, 0] * e + affine[0, 1] * f, affine[1, 0] * e + affine[1, 1] * f
            u, v, last = u + du, v + dv, max(abs(du), abs(dv))
            for i in range(2):
                for j in range(2):
                    one = min(max(found[2 + j], -stretch), stretch)
                    other = min(max(found[4 + j], -stretch), stretch)
                    change[i, j] = affine[i, 0] * one + affine[i, 1] * other
            affine += change
        variance *= _dot(rest, rest) / (size - UNKNOWNS) * correlated_neighbours(rest, side)
        _draw_patch(searches[n], affine, u, v, patch)
        _affine_columns(patch, design)
        energy = np.sqrt(power * _dot(design[6], design[6]))
        out[n, 0], out[n, 1], out[n, 2], out[n, 8] = u, v, np.sqrt(variance), last
        out[n, 3:7] = affine.ravel()
        out[n, 7] = _dot(template, design[6]) / max(energy, FAINT)
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


@compiled()
def _window_rows(
    a: np.ndarray, b: np.ndarray, window: Window, rows: tuple[int, int], sums: np.ndarray
) -> None:
    """Sums of a b over the windows about the pixels of some rows; 0 beyond the image.

    `window` has the weights from the middle outwards, across and down, equal on both sides.
    """
    across, down = window
    lines, samples = a.shape
    reach, rise = len(across) - 1, len(down) - 1
    product = np.zeros(samples + 2 * reach, np.float32)
    ring = np.zeros((2 * rise + 1, samples), np.float32)  # sums along the last rows
    for line in range(rows[0] - rise, rows[1] + rise):
        along = ring[line % len(ring)]
        along[:] = 0
        if 0 <= line < lines:
            for x in range(samples):
                product[x + reach] = a[line, x] * b[line, x]
            _add_pairs(product[reach:], product[reach:], HALF * across[0], along)
            for k in range(1, reach + 1):
                _add_pairs(product[reach - k :], product[reach + k :], across[k], along)
        y = line - rise
        if y >= rows[0]:
            out = sums[y]
            out[:] = 0
            middle = ring[y % len(ring)]
            _add_pairs(middle, middle, HALF * down[0], out)
            for k in range(1, rise + 1):
                _add_pairs(ring[(y - k) % len(ring)], ring[(y + k) % len(ring)], down[k], out)


@compiled()
def _add_pairs(a: np.ndarray, b: np.ndarray, weight: np.float32, out: np.ndarray) -> None:
    """Add weight (a + b) to the pixels of a row."""
    for x in range(len(out)):
        out[x] += weight * (a[x] + b[x])


@compiled("image", "image", ("row", "row"), ("row", "row"), "int32")
def window_sums(
    a: np.ndarray, b: np.ndarray, far: Window, near: Window, far_lines: int
) -> np.ndarray:
    """Sums of a b over the windows about all pixels: pixels (x, y) count across[|x|] down[|y|].

    Args:
        a: An image; 0 beyond its borders.
        b: Another one.
        far: Weights from the middle outwards, across and down, of the upper rows.
        near: Those of the rest.
        far_lines: Number of the upper rows.
    """
    sums = np.empty_like(a)
    _window_rows(a, b, far, (0, far_lines), sums)
    _window_rows(a, b, near, (far_lines, len(a)), sums)
    return sums


@compiled("image", "image", "image")
def window_variance(squares: np.ndarray, sums: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Variance in windows, from sums of squares and of values, and their number; not negative."""
    variance = np.empty_like(sums)
    for y in range(sums.shape[0]):
        for x in range(sums.shape[1]):
            n = count[y, x]
            mean = sums[y, x] / n
            variance[y, x] = max(squares[y, x] / n - mean * mean, np.float32(0))
    return variance


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


@compiled()
def _join(differences: np.ndarray, stiffness: np.ndarray, edge: np.float32) -> None:
    """Stiffness of neighbours by their differences, which it replaces; 0 at gaps."""
    for y in range(differences.shape[0]):
        for x in range(differences.shape[1]):
            off = differences[y, x] / edge
            differences[y, x] = 0 if np.isnan(off) else stiffness[y] / (ONE + off * off)


@compiled("image", ("image",) * 2, ("row",) * 2, ("float32",) * 2, "float32", "int32")
def relax_membrane(
    parallax: np.ndarray,
    fit: tuple[np.ndarray, np.ndarray],
    stiffness: tuple[np.ndarray, np.ndarray],
    gradient: tuple[np.float32, np.float32],
    edge: np.float32,
    sweeps: int,
) -> np.ndarray:
    """Parallax p + d, towards the least sum (w d^2 - 2 b d) + sum k (difference - g)^2.

    Differences are those of p + d between neighbours in a row and in a column. Their stiffness k
    is less where they are large at first, k = k_0 / (1 + (difference of p - g)^2 / edge^2). By
    successive over-relaxation, of the pixels of each colour of a chessboard in turn.

    Args:
        parallax: p; NaN where there is none.
        fit: w and b; 0 where there is no parallax.
        stiffness: k_0 within every row, and from it to the next one.
        gradient: g, the differences expected within rows and from one to the next.
        edge: Deviation from them at which the stiffness is halved.
        sweeps: How often every pixel is corrected.
    """
    lines, samples = parallax.shape
    weight, pull = fit
    p = np.zeros((lines + 2, samples + 2), np.float32)
    along = np.zeros((lines, samples + 1), np.float32)
    across = np.zeros((lines + 1, samples), np.float32)
    for y in range(lines):
        for x in range(samples):
            p[y + 1, x + 1] = 0 if np.isnan(parallax[y, x]) else parallax[y, x]
    along[:, 1:-1] = parallax[:, 1:] - parallax[:, :-1] - gradient[0]
    across[1:-1] = parallax[1:] - parallax[:-1] - gradient[1]
    _join(along, stiffness[0], edge)
    _join(across[1:], stiffness[1], edge)
    along[:, 0] = along[:, -1] = 0
    across[-1] = 0
    for sweep in range(2 * sweeps):
        for y in range(lines):
            for x in range((y + sweep) & 1, samples, 2):
                left, right = along[y, x], along[y, x + 1]
                above, below = across[y, x], across[y + 1, x]
                total = weight[y, x] + left + right + above + below
                if total > 0:
                    here = p[y + 1, x + 1]
                    force = weight[y, x] * (parallax[y, x] - here) + pull[y, x]
                    force += left * (p[y + 1, x] + gradient[0] - here)
                    force += right * (p[y + 1, x + 2] - gradient[0] - here)
                    force += above * (p[y, x + 1] + gradient[1] - here)
                    force += below * (p[y + 2, x + 1] - gradient[1] - here)
                    p[y + 1, x + 1] = here + OVER_RELAXATION * force / total
    relaxed = np.empty_like(parallax)
    for y in range(lines):
        for x in range(samples):
            moved = min(max(p[y + 1, x + 1] - parallax[y, x], -ONE), ONE)
            relaxed[y, x] = parallax[y, x] + moved
    return relaxed


@compiled("image", "float32", "int32")
def fixed_point(values: np.ndarray, units: np.float32, gap: int) -> np.ndarray:
    """Values in 16 bits, `units` to 1, `gap` where they are NaN or out of range."""
    fixed = np.empty(values.shape, np.int16)
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            scaled = np.rint(values[y, x] * units)
            fixed[y, x] = scaled if abs(scaled) < abs(gap) else gap
    return fixed


@compiled("image", "image", "float32")
def mutual_parallax(forth: np.ndarray, back: np.ndarray, largest: np.float32) -> np.ndarray:
    """Parallax from left to right where that from right to left differs by at most `largest`.

    Args:
        forth: Parallax on the left grid; NaN where there is none.
        back: Parallax on the right grid.
        largest: Largest difference, pixels.
    """
    mutual = np.full_like(forth, np.nan)
    samples = forth.shape[1]
    for y in range(forth.shape[0]):
        for x in range(samples):
            p = forth[y, x]
            if not np.isnan(p):
                partner = int(np.rint(np.float32(x) - p))
                if 0 <= partner < samples and abs(p - back[y, partner]) <= largest:
                    mutual[y, x] = p
    return mutual


@compiled("image", "image", "image", "image", "mask", "float32")
def local_contrast(
    grey: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    share: np.ndarray,
    mask: np.ndarray,
    floor: np.float32,
) -> np.ndarray:
    """(I - m) / sqrt(s^2 + floor) at the usable pixels, from local means; 0 elsewhere.

    Args:
        grey: Grey values; 0 where not usable.
        mean: Their local mean, pixels not usable included.
        square: That of their squares.
        share: That of the mask.
        mask: The usable pixels.
        floor: Variance of noise.
    """
    contrast = np.zeros_like(grey)
    for y in range(grey.shape[0]):
        for x in range(grey.shape[1]):
            if mask[y, x]:
                m = mean[y, x] / share[y, x]
                variance = max(square[y, x] / share[y, x] - m * m, np.float32(0))
                contrast[y, x] = (grey[y, x] - m) / np.sqrt(variance + floor)
    return contrast


@compiled("image", "image", "image")
def foerstner(xx: np.ndarray, xy: np.ndarray, yy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight w = det N / tr N and roundness q = 4 det N / (tr N)^2 of the matrices N of windows."""
    w, q = np.empty_like(xx), np.empty_like(xx)
    for y in range(xx.shape[0]):
        for x in range(xx.shape[1]):
            determinant = xx[y, x] * yy[y, x] - xy[y, x] * xy[y, x]
            trace = max(xx[y, x] + yy[y, x], np.float32(TINY))
            w[y, x] = determinant / trace
            q[y, x] = FOUR * determinant / (trace * trace)
    return w, q


@compiled("image", "row", "row", ("float32",) * 3, ("float32",) * 2)
def metres_per_line(
    up: np.ndarray,
    north_m: np.ndarray,
    east_m: np.ndarray,
    camera: tuple[np.float32, np.float32, np.float32],
    facing: tuple[np.float32, np.float32],
) -> np.ndarray:
    """Height bias of every cell for b = 1, metres; see `height_bias`.

    Args:
        up: Smoothed elevations, north up; NaN where the slope is unknown.
        north_m: Of the rows from the camera,
        east_m: and of the columns, east.
        camera: Its elevation, metres; focal length, pixels; and the side of a cell, metres.
        facing: Least tangent of the angle between ray and facet, and that at which the bias is b.
    """
    mast_m, focal_px, cell_m = camera
    least, level = facing
    rows, cols = up.shape
    metres = np.empty_like(up)
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for col in range(cols):
            before, after = max(col - 1, 0), min(col + 1, cols - 1)
            by_row = (up[below, col] - up[above, col]) / (np.float32(below - above) * cell_m)
            by_col = (up[row, after] - up[row, before]) / (np.float32(after - before) * cell_m)
            x, y = east_m[col], north_m[row]
            away_m = max(np.sqrt(x * x + y * y), cell_m)
            tangent = (mast_m - up[row, col] + by_col * x - by_row * y) / away_m
            if not np.isfinite(tangent):
                tangent = mast_m / away_m
            line_m = np.sqrt(away_m * away_m + mast_m * mast_m) / focal_px
            metres[row, col] = line_m / np.sqrt(max(tangent, least) / level)
    return metres
