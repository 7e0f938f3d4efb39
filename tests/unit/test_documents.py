"""What documents say of tests and files is true."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FEATURES = ROOT / "docs" / "reference" / "features.md"
TEST = re.compile(r"`(?P<file>[\w/-]+\.\w+)(?:::(?P<name>\w+))?`")


def rows() -> list[str]:
    return [line for line in FEATURES.read_text().splitlines() if re.match(r"\| \d", line)]


def test_every_row_of_the_table_of_features_is_there():
    assert [int(row.split("|")[1]) for row in rows()] == list(range(1, 55))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip())
def test_a_feature_that_is_claimed_is_shown_by_a_test_that_exists(row):
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
    *(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "decisions"),
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_source_files_and_commands_that_documents_name_exist(document):
    files = {str(path.relative_to(ROOT)) for path in _sources()}
    endings = {"/".join(file.split("/")[n:]) for file in files for n in range(file.count("/") + 1)}
    text = document.read_text()
    named = set(re.findall(r"`((?:[\w-]+/)*[\w-]+\.py)(?:`|::)", text))
    assert named - endings == set()
    modules = {file.removesuffix(".py").replace("/", ".") for file in files}
    commands = re.findall(r"python -m (tests\.[\w.]*\w)", text)
    assert {name for name in commands if name not in modules | {"tests.support"}} == set()


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
