"""Statements of documents about tests and files are true."""

import functools
import re
import subprocess
import textwrap
from pathlib import Path

import pytest

import solmap
from tests.support.pages import GENERATED, REFERENCE, all_commands, page

ROOT = Path(__file__).resolve().parents[2]
FEATURES = ROOT / "docs" / "reference" / "features.md"
TEST = re.compile(r"`(?P<file>[\w/-]+\.\w+)(?:::(?P<name>\w+))?`")


def rows() -> list[str]:
    return [line for line in FEATURES.read_text().splitlines() if re.match(r"\| \d", line)]


def test_every_row_of_the_table_of_features_exists():
    assert [int(row.split("|")[1]) for row in rows()] == list(range(1, 60))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip())
def test_every_claimed_feature_names_an_existing_test(row):
    claimed = row.split("|")[3].strip()
    test = TEST.search(row)
    if claimed.startswith("–"):
        assert test is None
        return
    file = ROOT / test["file"]
    assert file.is_file(), f"{file} is not there"
    if test["name"]:
        assert f"def {test['name']}(" in file.read_text()


DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "ARCHITECTURE.md",
    ROOT / "CONTRIBUTING.md",
    *(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "decisions"),
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_source_files_and_commands_in_documents_exist(document):
    files = {str(path.relative_to(ROOT)) for path in _sources()}
    endings = {"/".join(file.split("/")[n:]) for file in files for n in range(file.count("/") + 1)}
    text = document.read_text()
    named = set(re.findall(r"`((?:[\w-]+/)*[\w-]+\.py)(?:`|::)", text))
    assert named - endings == set()
    modules = {file.removesuffix(".py").replace("/", ".") for file in files}
    commands = re.findall(r"python -m (tests\.[\w.]*\w)", text)
    assert {name for name in commands if name not in modules | {"tests.support"}} == set()


@functools.cache
def _sources() -> list[Path]:
    folders = ("config", "flows", "gis_server", "photogrammetry", "products", "tasks", "tests")
    return [
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
        if "node_modules" not in path.parts
    ]


def test_names_of_the_glossary_are_names_in_the_code():
    lines = (ROOT / "docs" / "reference" / "glossary.md").read_text().splitlines()
    cells = [line.split("|")[4] for line in lines if line.startswith("| ") and line.count("|") > 5]
    names = {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    files = [path for path in _sources() if path.parts[len(ROOT.parts)] != "tests"]
    paths = " ".join(f"/{path.relative_to(ROOT)} " for path in files)
    words = set(re.findall(r"\w+", "\n".join(path.read_text() for path in files)))
    missing = {
        name
        for name in names
        if not (f"/{name} " in paths or f"/{name.rstrip('/')}/" in paths)
        and name.rpartition(".")[2] not in words
    }
    assert len(names) > 80
    assert missing == set()


@pytest.mark.parametrize("name", GENERATED)
def test_generated_parts_of_pages_are_current(name):
    current = (REFERENCE / name).read_text(encoding="utf-8")
    assert current == page(name), "run `python -m tests.support.pages`"


FENCED = re.compile(r"^```\w*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INDENTED = re.compile(r"^ {4}(\S.*)$", re.MULTILINE)
INLINE = re.compile(r"`([^`]+)`")
CALL = re.compile(r"(?:^|\s)(?:\.venv/bin/)?solmap ([a-z].*)")


def command_lines(text: str) -> list[str]:
    """What follows `solmap` in blocks of code and in code within a sentence."""
    sentences = FENCED.sub("", text)
    lines = "\n".join([*FENCED.findall(text), *INDENTED.findall(sentences)]).splitlines()
    codes = [" ".join(code.split()) for code in INLINE.findall(INDENTED.sub("", sentences))]
    return [found[1] for found in map(CALL.search, [*lines, *codes]) if found]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_and_options_in_documents_exist(document):
    known = {
        name.removeprefix("solmap "): {word for one in command.params for word in one.opts}
        for name, command in all_commands()
    }
    groups = {name.rpartition(" ")[0] for name in known} - {""}
    for line in command_lines(document.read_text()):
        words = [word.strip("[](),;:`") for word in re.split(r"\s[#|;>]", line)[0].split()]
        name = max(
            (n for n in known if words[: n.count(" ") + 1] == n.split()), default="", key=len
        )
        assert name or words[0] in groups | {"judge"}, f"{document.name}: solmap {line}"
        options = {word.partition("=")[0] for word in words if word.startswith("--")} - {"--help"}
        assert not name or options <= known[name], f"{document.name}: solmap {line}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_make_targets_and_test_files_in_documents_exist(document):
    text = document.read_text()
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))
    targets |= set(re.findall(r"^SUITES := (.*)$", makefile, re.MULTILINE)[0].split())
    calls = re.findall(r"(?:^ {4}|`)make ([a-z][\w -]*)", text, re.MULTILINE)
    named = {word for call in calls for word in call.split() if word.islower()}
    assert named <= targets
    assert [
        path for path in re.findall(r"tests/[\w/]+\.py", text) if not (ROOT / path).is_file()
    ] == []


BLOCK = re.compile(
    r"^```\w*\n(.*?)^```$|(^ {4}\S[^\n]*\n(?:(?: {4}[^\n]*)?\n)*)", re.DOTALL | re.MULTILINE
)
SHELL = {"export", "git", "make", "npm", "podman", "prefect", "pytest", "python", "solmap", "sudo"}


def blocks(text: str) -> list[str]:
    """Code between fences and indented code, without the indent."""
    return [fenced or textwrap.dedent(indented) for fenced, indented in BLOCK.findall(text)]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_shell_commands_in_documents_parse(document):
    for block in blocks(document.read_text()):
        if Path(block.split()[0]).name in SHELL:
            parsed = subprocess.run(
                ["/bin/bash", "-n"], input=block, capture_output=True, text=True, check=False
            )
            assert parsed.stderr == "", block


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_python_in_documents_compiles_and_names_what_solmap_has(document):
    for block in blocks(document.read_text()):
        if not re.match(r"(?:import|from) \w", block):
            continue
        compile(block, document.name, "exec")
        for name in re.findall(r"\bsolmap\.([A-Za-z_]\w*)", block):
            assert hasattr(solmap, name), f"{document.name}: solmap.{name}"


def test_prefect_commands_in_documents_are_those_that_a_test_runs():
    ran = (ROOT / "tests" / "integration" / "test_deployments.py").read_text()
    text = (ROOT / "docs" / "how-to" / "deploy.md").read_text()
    lines = re.findall(r"^ {4}prefect (.*)$", text, re.MULTILINE)
    assert len(lines) > 4
    assert [
        line for line in lines if not all(f'"{word}"' in ran for word in line.split()[:2])
    ] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_of_deploy_and_config_in_documents_exist(document):
    named = re.findall(r"\b((?:deploy|config)/[\w./-]*\w)", document.read_text())
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_links_of_pages_outside_the_site_lead_to_files():
    for name in ("README.md", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md"):
        links = re.findall(r"\]\((?!\w+:)([^)#]+)", (ROOT / name).read_text())
        assert [link for link in links if not (ROOT / link).exists()] == [], name


def test_a_page_that_abbreviates_the_local_frame_spells_it_out():
    pages = [path for path in DOCUMENTS if re.search(r"\bLSL\b", path.read_text())]
    assert [
        p.name for p in pages if not re.search("landing-site local", p.read_text(), re.IGNORECASE)
    ] == []
