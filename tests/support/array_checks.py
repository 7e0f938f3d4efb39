"""Checks of the types and shapes of arrays at every call of a function of the science.

Each annotated function is checked by beartype, its arguments and its answer with the same sizes of
the axes. jaxtyping's own import hook does so too, at five times the cost: it binds each call's
arguments to a signature, checks them twice, and compiles the checks of a function inside a function
at each call of the outer one. Those are left to the checks of what they are given and return.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from functools import wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from inspect import get_annotations, isclass, isgeneratorfunction, signature
from types import ModuleType, SimpleNamespace
from typing import Any, ForwardRef, get_args, get_type_hints

from beartype import beartype
from beartype.door import die_if_unbearable
from jaxtyping import AbstractArray, jaxtyped

PACKAGE = "solmap.photogrammetry"
_CHECKED = f"__import__({__name__!r}, fromlist=['checked']).checked"
_AXES = jaxtyped("context")
"""Within it, an axis has one size wherever its name is used."""


def install() -> None:
    """Check what is imported from now on."""
    sys.meta_path.insert(0, _Finder())


def checked(defined: Any) -> Any:
    """A function that checks its arguments and answer, or a record that checks its fields."""
    if not isclass(defined):
        return _checking(defined, [defined])
    if is_dataclass(defined) and "__init__" in vars(defined):
        defined.__init__ = _checking(defined.__init__, defined.__mro__[::-1])
    return defined


def _checking(function: Callable[..., Any], annotated: Sequence[Any]) -> Callable[..., Any]:
    """A function checked by the annotations of `annotated`, once all they name is defined."""
    check: Callable[..., Any] | None = None
    has_arrays = False

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal check, has_arrays
        __tracebackhide__ = True
        if check is None:
            hints = {name: hint for one in annotated for name, hint in _hints(one)}
            has_arrays = any(_names(hint, AbstractArray) for hint in hints.values())
            function.__annotations__ = {name: hints.get(name) for name in get_annotations(function)}
            check = _generating(function) if isgeneratorfunction(function) else beartype(function)
        if not has_arrays:
            return check(*args, **kwargs)
        with _AXES:
            return check(*args, **kwargs)

    return call


def _generating(function: Callable[..., Any]) -> Callable[..., Any]:
    """Checks arguments when called: the body runs later, among the axes of others."""
    parameters = signature(function)

    def check(*args: Any, **kwargs: Any) -> Any:
        for name, value in parameters.bind(*args, **kwargs).arguments.items():
            if name in function.__annotations__:
                die_if_unbearable(value, function.__annotations__[name])
        return function(*args, **kwargs)

    return check


def _hints(annotated: Any) -> Iterator[tuple[str, Any]]:
    """Annotations by name; Any for what only mypy understands: aliases that name themselves."""
    space = vars(sys.modules[annotated.__module__])
    for name, hint in get_annotations(annotated).items():
        one = SimpleNamespace(__annotations__={name: hint})
        try:
            found = get_type_hints(one, space, include_extras=True)[name]
        except TypeError:
            found = Any
        yield name, Any if _names(found, ForwardRef) else found


def _names(hint: Any, kind: type) -> bool:
    is_one = issubclass(hint if isclass(hint) else type(hint), kind)
    return is_one or any(_names(part, kind) for part in get_args(hint))


class _Finder(MetaPathFinder):
    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != PACKAGE and not name.startswith(f"{PACKAGE}."):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(name, spec.loader.path)
        return spec


class _Loader(SourceFileLoader):
    """Decorates functions and classes; what it compiles is kept beside the ordinary."""

    def source_to_code(self, data: Any, path: Any, *, _optimize: int = -1) -> Any:
        tree = _Decorating().visit(ast.parse(data, path))
        return compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)

    def get_data(self, path: str) -> bytes:
        return super().get_data(_beside(path))

    def set_data(self, path: str, data: Any, *, _mode: int = 0o666) -> None:
        super().set_data(_beside(path), data, _mode=_mode)


def _beside(path: str) -> str:
    return f"{path.removesuffix('.pyc')}.checked.pyc" if path.endswith(".pyc") else path


class _Decorating(ast.NodeTransformer):
    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        node.decorator_list.insert(0, ast.parse(_CHECKED, mode="eval").body)
        self.generic_visit(node)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.decorator_list.append(ast.parse(_CHECKED, mode="eval").body)
        return node
