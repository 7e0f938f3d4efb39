"""Functions compiled to machine code, for loops over pixels that NumPy takes in many passes.

Numba compiles a function for the types of its arguments when it is first called, and keeps the
result beside its module, or in the user's cache folder where that cannot be written; later
processes load it in milliseconds. A process that can write neither compiles for itself.

A kept result is compiled again when the file of its function changes, not when another file does:
whatever a compiled function calls, and constants that it names, belong into the same file.
"""

from __future__ import annotations

import importlib
import multiprocessing
import pkgutil
from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

Kinds = tuple["str | Kinds", ...]
"""Kinds of arguments: of `ARRAYS` or a type of Numba, and tuples of these."""

ARRAYS = {
    "image": ("float32", 2),
    "mask": ("boolean", 2),
    "row": ("float32", 1),
    "pixels": ("int32", 2),
    "planes": ("float32", 3),
    "points": ("float64", 2),
    "windows": ("float64", 3),
    "per_point": ("float64", 1),
    "numbers": ("int32", 1),
    "indices": ("int64", 1),
}
"""Contiguous arrays, which may be read only: types of their elements, and dimensions."""

KERNELS: list[Compiled[..., Any]] = []
"""The compiled functions of all modules imported so far."""


class Compiled(Generic[P, R]):
    """A function that is compiled when it is first called, or called by another one."""

    def __init__(self, function: Callable[P, R], kinds: Kinds, *, reorder_sums: bool) -> None:
        self.function, self.kinds = function, kinds
        self.fast = {"contract", "reassoc", "nsz"} if reorder_sums else {"contract"}
        update_wrapper(self, function)
        KERNELS.append(self)

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """Call the compiled function."""
        return self.dispatcher(*arguments, **named)

    @cached_property
    def dispatcher(self) -> Any:  # noqa: ANN401 - of numba
        """The compiled function."""
        if not self.kinds:
            return self._build(forceinline=True)
        try:
            return self._build(_types(self.kinds), cache=True)
        except (RuntimeError, OSError):  # no folder for the result can be written
            return self._build(_types(self.kinds))

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401
        """How compiled functions that call this one see it."""
        return self.dispatcher._numba_type_

    def _build(self, *types: Any, **how: bool) -> Any:  # noqa: ANN401
        from numba import njit  # noqa: PLC0415 - takes as long as all else that a command imports

        options = {"nogil": True, "error_model": "numpy", "fastmath": self.fast}
        return njit(*types, **options, **how)(self.function)


def _types(kinds: Kinds) -> tuple[Any, ...]:
    """Types of Numba."""
    from numba import types  # noqa: PLC0415

    def one(kind: str | Kinds) -> Any:  # noqa: ANN401
        if isinstance(kind, tuple):
            return types.Tuple(_types(kind))
        if kind in ARRAYS:
            element, dimensions = ARRAYS[kind]
            return types.Array(getattr(types, element), dimensions, "C", readonly=True)
        return getattr(types, kind)

    return tuple(one(kind) for kind in kinds)


def compiled(
    *kinds: str | Kinds, reorder_sums: bool = False
) -> Callable[[Callable[P, R]], Compiled[P, R]]:
    """Compile a function for arguments of some kinds; without any, as a part of others.

    Args:
        kinds: Kinds of the arguments.
        reorder_sums: Whether terms may be summed in any order, as processors do that add several
            at a time.
    """
    return lambda function: Compiled(function, kinds, reorder_sums=reorder_sums)


def load_compiler() -> None:
    """Load Numba and one of the functions imported so far, which takes longer than all others.

    Otherwise the first call does, for a third of a second in which other threads wait too.
    """
    for function in KERNELS:
        if function.kinds:
            _ = function.dispatcher
            return


def compile_all() -> None:
    """Compile, and keep, all functions of the science with known kinds of arguments."""
    package = importlib.import_module(__package__)
    for module in pkgutil.walk_packages(package.__path__, f"{__package__}."):
        importlib.import_module(module.name)
    with multiprocessing.get_context("fork").Pool() as pool:
        pool.map(_compile, range(len(KERNELS)), chunksize=1)


def _compile(number: int) -> None:
    if KERNELS[number].kinds:
        _ = KERNELS[number].dispatcher
