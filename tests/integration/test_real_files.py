"""The page about real files states their current outcome."""

from pathlib import Path

from tests.support.real_files import FILES, HEAD, page

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "real-files.md"


def test_the_page_about_real_files_states_their_outcome(shared_data):
    assert len(FILES) >= 30
    assert PAGE.read_text() == page(shared_data)


def test_every_refusal_on_the_page_names_a_command():
    rows = PAGE.read_text().removeprefix(HEAD).splitlines()
    assert len(rows) == len(FILES)
    refused = [row for row in rows if "| refused: " in row]
    assert refused
    assert all("`solmap " in row for row in refused)
