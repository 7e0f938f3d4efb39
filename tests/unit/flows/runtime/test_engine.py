"""The password of a store's engine."""

from solmap.flows.runtime.engine import password_file


def test_a_password_is_made_once_and_for_its_owner_only(tmp_path):
    file = password_file(tmp_path)
    secret = file.read_text()
    assert secret.startswith("solmap:")
    assert len(secret) > 40
    file.chmod(0o644)
    assert password_file(tmp_path).read_text() == secret
    assert file.stat().st_mode & 0o777 == 0o600
    assert list(file.parent.iterdir()) == [file]


def test_an_empty_password_which_lets_all_in_is_made_anew(tmp_path):
    file = password_file(tmp_path)
    file.write_text("")
    assert len(password_file(tmp_path).read_text()) > 40
