"""Packages stay small and explain themselves; what is installed is what is imported."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml

from tests.support.structure import ROOT, folders, modules

MOST_MODULES = 16
KNOWN = modules()
PACKAGES = sorted(name for name, module in KNOWN.items() if module.is_package)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_no_folder_has_more_than_the_limit_of_modules():
    assert {str(f): n for f, n in folders(KNOWN).items() if n > MOST_MODULES} == {}


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_describes_its_content(name):
    text = ast.get_docstring(KNOWN[name].tree) or ""
    assert len(text.split()) >= 8, f"{name}/__init__.py does not state what enters and what leaves"


def test_every_folder_of_modules_is_a_package():
    assert {m.path.parent for m in KNOWN.values()} == {KNOWN[name].path.parent for name in PACKAGES}


def test_the_links_of_the_import_name_are_the_top_level_packages():
    links = {path.name for path in (ROOT / "src" / "solmap").iterdir() if path.is_symlink()}
    assert links == {name for name in PACKAGES if "." not in name}


def imported_distributions() -> set[str]:
    """Distributions that production modules import, at their top or inside functions."""
    names = set()
    for module in KNOWN.values():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(str(node.module))
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
    tops = {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"solmap"}
    owners = {**packages_distributions(), "pystac": ["pystac"]}  # an extension shares its name
    return {_normal(owners.get(top, [top])[0]) for top in tops}


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _declared(lines: list[str]) -> set[str]:
    return {_normal(re.match(r"[\w.-]+", line)[0]) for line in lines}


def test_runtime_dependencies_are_what_production_code_imports():
    required = _declared(PROJECT["dependencies"])
    extras = PROJECT["optional-dependencies"]
    names = "cluster", "draco", "spice"
    optional = _declared([line for name in names for line in extras.get(name, [])])
    imported = imported_distributions()
    assert imported - required - optional == set()
    assert required - imported == set()


def test_no_test_or_benchmark_writes_a_figure_of_the_documentation():
    path_into_docs = re.compile(r"[\"']docs[\"'] */ *[\"']figures[\"']")
    tests = (ROOT / "tests").rglob("*.py")
    assert [str(path) for path in tests if path_into_docs.search(path.read_text())] == []


def test_the_version_is_written_once():
    assert "version" in PROJECT["dynamic"]
    assert "__version__" in Path(ROOT / "src" / "solmap" / "__init__.py").read_text()


def test_hooks_before_a_commit_run_the_tools_of_make_check():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    rules = (ROOT / "Makefile").read_text().partition("\ncheck: develop")[2].partition("\n\n")[0]
    called = re.findall(r"\$\(BIN\)/([\w-]+(?: check| format --check)?)", rules)
    assert [hook["entry"].removeprefix(".venv/bin/") for hook in hooks] == called
