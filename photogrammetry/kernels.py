"""Compiled loops over windows of a raster: planes (see `planes`), and means of four cells."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.compiled import compiled

NAN = np.float32(np.nan)
LEAST_SPREAD = 0.02
"""Second moment of the cells used, along their thinnest direction, over that of a full window. A
strip of cells a seventh as wide as the window is the narrowest that defines a plane."""
LEAST_POINTS = 3
LAYERS = 6
"""Layers of planes: gradient towards east and north, metres per cell; C_ee, C_en and C_nn of the
cells used, in cells; standard deviation of the elevations from the plane, metres."""

Sums = tuple[float, float, float, float, float, float, float, float, float, float]
"""S_1, S_e, S_n, S_ee, S_en, S_nn, S_h, S_eh, S_nh and S_hh."""


@compiled("image", "int64", "float64", ("int64", "int64", "int64", "int64"), "int64")
def window_planes(
    elevation: np.ndarray, half: int, min_share: float, own: tuple[int, int, int, int], layers: int
) -> np.ndarray:
    """Planes through the cells around each cell; sums move with the window, column by column.

    Args:
        elevation: (rows, cols), metres; NaN where unknown.
        half: Cells of the window to either side of its middle one.
        min_share: Least share of known cells in the window.
        own: The cells to fit planes to: first row and column, rows and columns.
        layers: `LAYERS`, or 2 for the gradient only.

    Returns:
        (layers, own rows, own columns); NaN where unknown, or where too few cells are known.
    """
    first_row, first_col, own_rows, own_cols = own
    rows, cols = elevation.shape
    found = np.full((layers, own_rows, own_cols), NAN)
    level = float(np.nanmean(elevation))
    cells = (2 * half + 1) ** 2
    thinnest = LEAST_SPREAD * cells * (cells - 1) / 12
    columns = np.zeros((6, cols))  # sums of 1, n, n^2, h, n h, h^2 over the window's rows
    for row in range(-half, first_row + own_rows):
        for sign, moved in ((1, row + half), (-1, row - half - 1)):
            if 0 <= moved < rows:
                for col in range(cols):
                    if not np.isnan(elevation[moved, col]):
                        h = elevation[moved, col] - level
                        columns[0, col] += sign
                        columns[1, col] -= sign * moved
                        columns[2, col] += sign * moved * moved
                        columns[3, col] += sign * h
                        columns[4, col] -= sign * moved * h
                        columns[5, col] += sign * h * h
        if row < first_row:
            continue
        sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for col in range(-half, first_col + own_cols):
            if col + half < cols:
                sums = _add(sums, columns, col + half, 1.0)
            if col > half:
                sums = _add(sums, columns, col - half - 1, -1.0)
            if col < first_col or np.isnan(elevation[row, col]) or sums[0] < min_share * cells:
                continue
            S_1, S_e, S_n, S_ee, S_en, S_nn, S_h, S_eh, S_nh, S_hh = sums
            C_ee, C_en, C_nn = (
                S_ee - S_e * S_e / S_1,
                S_en - S_e * S_n / S_1,
                S_nn - S_n * S_n / S_1,
            )
            C_eh, C_nh, C_hh = (
                S_eh - S_e * S_h / S_1,
                S_nh - S_n * S_h / S_1,
                S_hh - S_h * S_h / S_1,
            )
            if (C_ee + C_nn) / 2 - np.sqrt((C_ee - C_nn) ** 2 / 4 + C_en * C_en) <= thinnest:
                continue
            determinant = C_ee * C_nn - C_en * C_en
            g_e = (C_nn * C_eh - C_en * C_nh) / determinant
            g_n = (C_ee * C_nh - C_en * C_eh) / determinant
            plane = found[:, row - first_row, col - first_col]
            plane[0], plane[1] = g_e, g_n
            if layers == LAYERS:
                plane[2], plane[3], plane[4] = C_ee, C_en, C_nn
            if layers == LAYERS and S_1 > LEAST_POINTS:
                squares = max(C_hh - g_e * C_eh - g_n * C_nh, 0.0)
                plane[5] = np.sqrt(squares / (S_1 - LEAST_POINTS))
    return found


@compiled()
def _add(sums: Sums, columns: np.ndarray, col: int, sign: float) -> Sums:
    """Add a column to the window's sums, or subtract it."""
    S_1, S_e, S_n, S_ee, S_en, S_nn, S_h, S_eh, S_nh, S_hh = sums
    one, n, nn, h, nh, hh = (
        sign * columns[0, col],
        sign * columns[1, col],
        sign * columns[2, col],
        sign * columns[3, col],
        sign * columns[4, col],
        sign * columns[5, col],
    )
    return (
        S_1 + one,
        S_e + col * one,
        S_n + n,
        S_ee + col * col * one,
        S_en + col * n,
        S_nn + nn,
        S_h + h,
        S_eh + col * h,
        S_nh + nh,
        S_hh + hh,
    )


@compiled("planes")
def halve(bands: np.ndarray) -> np.ndarray:
    """Means of the known cells among 2 x 2, NaN where none is known.

    Args:
        bands: (bands, rows, cols), with even numbers of rows and columns; NaN where unknown.
    """
    count, rows, cols = bands.shape
    means = np.empty((count, rows // 2, cols // 2), np.float32)
    for band in range(count):
        for y in range(rows // 2):
            for x in range(cols // 2):
                total, known = 0.0, 0
                for row in range(2 * y, 2 * y + 2):
                    for col in range(2 * x, 2 * x + 2):
                        cell = bands[band, row, col]
                        if not np.isnan(cell):
                            total += cell
                            known += 1
                means[band, y, x] = total / known if known else NAN
    return means
