"""Figures of the source tree: `python -m tests.support.structure [CHECKOUT]`.

Modules and lines per folder, depth and number of imports inside a package, modules that exactly one
other module imports, and lengths of functions. `tests/unit/test_structure.py` holds the bounds.
"""

import ast
import sys
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("config", "flows", "gis_server", "photogrammetry", "products", "tasks")


@dataclass(frozen=True, slots=True)
class Module:
    """One source file: its dotted name below `solmap`, its tree and its lines."""

    name: str
    path: Path
    lines: int

    @property
    def tree(self) -> ast.Module:
        return _parsed(self.path)

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def modules(root: Path = ROOT) -> dict[str, Module]:
    """All modules of the production packages, by dotted name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if {"node_modules", "dist"} & set(path.parts):
                continue
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = Module(name, path, path.read_text().count("\n"))
    return found


def imports(module: Module, known: dict[str, Module]) -> set[str]:
    """Names of the modules that a module imports, at its top or inside functions."""
    found = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            full = name.removeprefix("solmap.")
            short = full.rpartition(".")[0]
            found |= {one for one in (full, short) if one in known and one != module.name}
    return {name for name in found if not known[name].is_package or known[name].lines > 1}


def levels(graph: dict[str, set[str]]) -> int:
    """Modules on the longest chain of imports."""

    @cache
    def depth(name: str) -> int:
        return 1 + max((depth(other) for other in graph[name]), default=0)

    return max((depth(name) for name in graph), default=0)


def function_lengths(known: dict[str, Module]) -> np.ndarray:
    """Lines of every function and method."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = (node for module in known.values() for node in ast.walk(module.tree))
    return np.array([1 + (n.end_lineno or 0) - n.lineno for n in nodes if isinstance(n, kinds)])


def folders(known: dict[str, Module]) -> dict[Path, int]:
    """Number of modules in each folder, `__init__` counted."""
    counts: dict[Path, int] = defaultdict(int)
    for module in known.values():
        counts[module.path.parent] += 1
    return counts


def main(root: Path) -> None:
    """Print the figures."""
    known = modules(root)
    graph = {name: imports(module, known) for name, module in known.items()}
    importers: dict[str, set[str]] = defaultdict(set)
    for name, others in graph.items():
        for other in others:
            importers[other].add(name)
    plain = [name for name, module in known.items() if not module.is_package]
    counts = sorted(
        ((n, str(f.relative_to(root))) for f, n in folders(known).items()), reverse=True
    )
    lengths = function_lengths(known)
    adjustment = [name for name in plain if name.startswith("photogrammetry.adjustment")]
    inner = {name: graph[name] & set(adjustment) for name in adjustment}
    rows = [
        ("modules", len(plain)),
        ("lines", sum(module.lines for module in known.values())),
        ("largest folders", ", ".join(f"{name} {n}" for n, name in counts[:6])),
        ("modules with one importer", sum(len(importers[name]) == 1 for name in plain)),
        ("functions", len(lengths)),
        ("function length, median and 95 %", np.percentile(lengths, [50, 95]).round().tolist()),
        ("adjustment: modules", len(adjustment)),
        ("adjustment: levels of imports", levels(inner)),
        ("adjustment: imports inside", sum(map(len, inner.values()))),
    ]
    for package in PACKAGES:
        inside = [known[name] for name in plain if name.split(".")[0] == package]
        rows.append((f"{package}: modules, lines", (len(inside), sum(m.lines for m in inside))))
    for title, value in rows:
        print(f"{title:36} {value}")  # noqa: T201 - this is a command


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT)
