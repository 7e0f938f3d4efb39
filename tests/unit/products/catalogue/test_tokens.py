"""Tokens open what their role allows until they end; their secrets are not kept."""

import pytest

from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.errors import ProductNotFoundError


@pytest.fixture
def book(tmp_path):
    return Tokens.of(tmp_path)


def test_a_token_is_identified_by_its_text_only(book):
    token, text = book.add("Ada", Role.ANALYST)
    assert book.verify(text) == token
    assert (token.name, token.role) == ("Ada", Role.ANALYST)
    for wrong in ("", "solmap", text[:-1], text + "x", text.replace(token.id, "00000000"), "a_b_c"):
        assert book.verify(wrong) is None


def test_the_secret_is_not_in_the_file_and_the_file_is_its_owners(book):
    _, text = book.add("Ada", Role.ANALYST)
    _, _, secret = text.split("_", 2)
    assert secret.encode() not in book.path.read_bytes()
    assert book.path.stat().st_mode & 0o077 == 0


def test_a_revoked_token_is_refused_and_stays_listed(book):
    token, text = book.add("Ada", Role.OPERATOR)
    _, other = book.add("Ben", Role.VIEWER)
    assert book.revoke(token.id).revoked_at is not None
    assert book.verify(text) is None
    assert book.verify(other) is not None
    assert [one.is_valid for one in book.tokens()] == [False, True]


def test_a_token_expires(book):
    _, text = book.add("Ada", Role.ANALYST, days=0)
    assert book.verify(text) is None
    _, text = book.add("Ada", Role.ANALYST, days=1)
    assert book.verify(text) is not None


def test_a_store_without_tokens_has_no_token_file(book):
    assert book.tokens() == []
    assert book.verify("solmap_a_b") is None
    assert not book.path.exists()


def test_an_unknown_token_cannot_be_revoked(book):
    with pytest.raises(ProductNotFoundError, match="solmap token list"):
        book.revoke("00000000")


def test_roles_include_those_before_them():
    assert Role.VIEWER < Role.ANALYST < Role.OPERATOR
    assert Role.of_name(str(Role.OPERATOR)) is Role.OPERATOR
