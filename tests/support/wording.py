"""Prose of the code, the documents and the viewer, searched for words that stop a reader.

    python -m tests.support.wording [CHECKOUT] [--list [FOLDER ...]]

prints the share of docstrings, comments, messages and texts that the word list
(`wording.toml`) catches, package by package, or every place where it does.
"""

import argparse
import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("photogrammetry", "products", "tasks", "config", "flows", "gis_server", "src")
VIEWER = "gis_server/viewer/src"
TESTS = tuple(
    f"tests/{name}"
    for name in ("support", "unit", "integration", "e2e", "benchmarks", "packaging", "fuzz")
)
DOCUMENTS = ("README.md", "CHANGELOG.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "docs")
FOLDERS = (*PACKAGES, VIEWER, *TESTS, *DOCUMENTS)
SKIPPED = (
    r"```.*?```|`[^`]*`|<style>.*?</style>|<[^>\n]*>|\{[^{}]*\}"
    r"|# (noqa|fmt|type):.*|\w+: [Tt]he \w+\.|\w+\.\w+\(.*?\)"
)
"""Code and markup in prose."""
FEWEST_WORDS = 3
"""Of a string that is a message and not a key or a pattern."""
STORED = frozenset(
    {"by_shape", "handed_on", "is_mended", "picture", "said", "said_of_strike"} | {"told_by"}
)
"""Names in recipes, stores and answers of the server, which stay for those who read them."""
LANGUAGE = frozenset({"Promise"})
"""Names of TypeScript."""


@dataclass(frozen=True, slots=True)
class Text:
    """A piece of prose and where it is."""

    path: Path
    line: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Fault:
    """A word of the list in a text, and what to write instead."""

    where: Text
    words: str
    instead: str

    def __str__(self) -> str:
        return f"{self.where.path}:{self.where.line}: {self.words!r}; write: {self.instead}"


@cache
def word_list() -> dict[re.Pattern[str], str]:
    """The patterns of `wording.toml`, each with what to write instead."""
    groups = tomllib.loads(Path(__file__).with_suffix(".toml").read_text()).values()
    return {
        re.compile(pattern, re.IGNORECASE): instead
        for group in groups
        for pattern, instead in group.items()
    }


def faults(text: Text) -> Iterator[Fault]:
    """The words of the list in a text; code in backticks and quoted words are left out."""
    for words, instead in _found(text.text):
        yield Fault(text, words, instead)


@cache
def _found(text: str) -> list[tuple[str, str]]:
    """What is found in a text, and what to write instead; most names are in several modules."""
    prose = re.sub(SKIPPED, " _ ", text, flags=re.DOTALL)
    prose = re.sub(r"\s+", " ", prose)
    matches = ((pattern.search(prose), instead) for pattern, instead in word_list().items())
    return [(found[0], instead) for found, instead in matches if found]


def names(path: Path, found: dict[str, int]) -> Iterator[Text]:
    """Names by their first line, as words."""
    for name, line in found.items():
        if name not in STORED | LANGUAGE:
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
            yield Text(path, line, "name", re.sub(r"[_.-]", " ", words))


def names_of_python(path: Path, nodes: list[ast.AST]) -> Iterator[Text]:
    """Names that a module defines."""
    found = {path.stem: 1}
    for node in nodes:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                pass
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                pass
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                pass
            case _:
                continue
        found.setdefault(name, node.lineno)
    yield from names(path, found)


def texts_of_python(path: Path, source: str) -> Iterator[Text]:
    """Names, docstrings, comments and strings of several words of a module."""
    nodes = list(ast.walk(ast.parse(source)))
    yield from names_of_python(path, nodes)
    documented = set()
    for node in nodes:
        match node:
            case ast.Expr(value=ast.Constant(value=str(text)) as constant):
                documented.add(id(constant))
                yield Text(path, constant.lineno, "docstring", text)
    parts = {id(part) for n in nodes if isinstance(n, ast.JoinedStr) for part in n.values}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            whole = "".join(
                part.value if isinstance(part, ast.Constant) else " _ " for part in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            whole = "" if id(node) in documented | parts else node.value
        else:
            continue
        is_code = re.search(r"\bSELECT\b|^import ", whole, re.MULTILINE)
        if len(re.findall(r"[a-z]{2,}", whole)) >= FEWEST_WORDS and not is_code:
            yield Text(path, node.lineno, "message", whole)
    line, read = 1, 0
    for found in COMMENT_OR_STRING.finditer(source):
        if found["comment"]:
            line, read = line + source.count("\n", read, found.start()), found.start()
            yield Text(path, line, "comment", found[0])


COMMENT_OR_STRING = re.compile(
    r"(?P<comment>\#[^\n]*)|(?P<quotes>\"{3}|'{3})(?:\\.|.)*?(?P=quotes)"
    r"|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'",
    re.DOTALL,
)
"""Of Python; a string may contain what looks like a comment."""
TYPESCRIPT_TEXT = re.compile(
    r"/\*.*?\*/|//[^\n]*|\"(?:[^\"\\\n]|\\.)*\"|`(?:[^`\\]|\\.)*`", re.DOTALL
)
"""Comments and strings."""


def blank(found: re.Match[str]) -> str:
    """A text as spaces, so that positions after it stay; expressions in a template are kept."""
    kept = {k for part in re.finditer(r"\$\{[^}]*\}", found[0]) for k in range(*part.span())}
    return "".join(one if k in kept or one == "\n" else " " for k, one in enumerate(found[0]))


def texts_of_typescript(path: Path, source: str) -> Iterator[Text]:
    """Names, comments and strings of several words of a module of the viewer."""
    found_names = {path.stem: 1}
    for found in re.finditer(r"\b[A-Za-z_]\w+", re.sub(TYPESCRIPT_TEXT, blank, source)):
        found_names.setdefault(found[0], source.count("\n", 0, found.start()) + 1)
    yield from names(path, found_names)
    for found in TYPESCRIPT_TEXT.finditer(source):
        text = found[0]
        kind = "comment" if text.startswith("/") else "message"
        prose = text if kind == "comment" else re.sub(r"\$\{[^}]*\}|<[^>]*>", " _ ", text[1:-1])
        words = len(re.findall(r"[a-z]{2,}", prose)) if " " in prose else 0  # a path is not prose
        if kind == "comment" or words >= FEWEST_WORDS:
            yield Text(path, source.count("\n", 0, found.start()) + 1, kind, prose)


def texts_of_markdown(path: Path, source: str) -> Iterator[Text]:
    """Paragraphs of a document, without blocks of code and addresses of links."""
    source = re.sub(r"```.*?```", lambda m: "\n" * m[0].count("\n"), source, flags=re.DOTALL)
    source = re.sub(r"\]\([^)]*\)", "]", source)
    line = 1
    for paragraph in re.split(r"(\n\s*\n)", source):
        if paragraph.strip():
            yield Text(path, line, "paragraph", paragraph)
        line += paragraph.count("\n")


READERS = {".py": texts_of_python, ".ts": texts_of_typescript, ".md": texts_of_markdown}


def texts(root: Path, folder: str) -> Iterator[Text]:
    """All prose of a folder, or of a file, below a checkout."""
    start = root / folder
    files = sorted(start.rglob("*")) if start.is_dir() else [start] if start.exists() else []
    for file in files:
        below = file.relative_to(root)
        if file.suffix not in READERS or not file.is_file() or "node_modules" in below.parts:
            continue
        if folder == "gis_server" and below.is_relative_to("gis_server/viewer"):
            continue
        if folder == "docs" and "decisions" in below.parts:
            continue  # dated notes, which stay as they were written
        if file.name == "test_wording.py":
            continue  # examples of what the list catches
        yield from READERS[file.suffix](below, file.read_text())


def main() -> None:
    """Print the share of texts that the word list catches, or each of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", nargs="?", type=Path, default=ROOT)
    parser.add_argument("--list", nargs="*", metavar="FOLDER", help="print every place")
    requested = parser.parse_args()
    if requested.list is not None:
        for folder in requested.list or FOLDERS:
            for text in texts(requested.checkout, folder):
                for fault in faults(text):
                    print(fault)  # noqa: T201
        return
    for folder in FOLDERS:
        every, caught = Counter[str](), Counter[str]()
        for text in texts(requested.checkout, folder):
            every[text.kind] += 1
            caught[text.kind] += any(True for _ in faults(text))
        for kind, count in every.items():
            share = caught[kind] / count
            print(f"{folder:24}{kind:10}{caught[kind]:6} of {count:5}  {share:6.1%}")  # noqa: T201


if __name__ == "__main__":
    main()
