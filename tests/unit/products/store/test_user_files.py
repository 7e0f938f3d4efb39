"""Files of users: regular ones of their folder, in bounds; anything else is refused at once."""

import os
import socket
from pathlib import Path

import pytest

from solmap.products.store.user_files import open_user_file, plain_name, read_user_file, reason_of


def refusal(path, folder=None):
    with pytest.raises(OSError) as refused, open_user_file(path, folder):  # noqa: PT011 - read below
        pass
    return reason_of(refused.value)


def test_a_file_is_read_whole(tmp_path):
    (tmp_path / "x.img").write_bytes(b"abc")
    assert read_user_file(tmp_path / "x.img") == b"abc"


def test_fifos_sockets_devices_and_folders_are_refused_without_waiting(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as one:
        one.bind("socket")
    (tmp_path / "to-fifo").symlink_to("fifo")
    assert refusal(tmp_path / "fifo") == "it is a FIFO; only regular files are read"
    assert refusal(tmp_path / "to-fifo") == "it is a FIFO; only regular files are read"
    assert refusal(tmp_path / "socket") == "it is a socket; only regular files are read"
    assert refusal(tmp_path) == "it is a folder; only regular files are read"
    with pytest.raises(OSError, match="it is a device"):
        read_user_file(Path("/dev/zero"))


def test_links_stay_in_their_folder(tmp_path):
    (tmp_path / "secret").write_bytes(b"secret")
    inside = tmp_path / "downlink"
    (inside / "sol1").mkdir(parents=True)
    (inside / "sol1" / "x.img").write_bytes(b"abc")
    (inside / "y.img").symlink_to("sol1/x.img")
    (inside / "sol1" / "z.img").symlink_to("../y.img")
    assert read_user_file(inside / "y.img", inside) == b"abc"
    assert read_user_file(inside / "sol1" / "z.img", inside) == b"abc"
    for target in (tmp_path / "secret", "../secret", "/proc/kmsg", "/dev/zero"):
        link = inside / "out.img"
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        assert refusal(link, inside) == "a link that leads out of its folder is not followed"
    (inside / "round.img").symlink_to("round.img")
    assert refusal(inside / "round.img", inside) == "a link to itself"


def test_a_folder_replaced_by_a_link_is_detected(tmp_path, monkeypatch):
    for name in ("inbox/sol1", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "x.img").write_bytes(name.encode())
    opening = os.open

    def exchange(path, *args, **kwargs):
        (tmp_path / "inbox/sol1").rename(tmp_path / "away")
        (tmp_path / "inbox/sol1").symlink_to(tmp_path / "elsewhere")
        return opening(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", exchange)
    path = tmp_path / "inbox/sol1/x.img"
    assert refusal(path, tmp_path / "inbox") == "it was replaced while it was opened"


def test_a_file_larger_than_the_limit_is_not_read(tmp_path):
    with (tmp_path / "sparse.img").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(OSError, match="at most 268435456 of such a file are read"):
        read_user_file(tmp_path / "sparse.img")


def test_a_kernel_file_without_a_size_ends_at_once():
    assert read_user_file(Path("/proc/self/status")) == b""


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("2N292280938EFFB100P0703L0M1.IMG", "2N292280938EFFB100P0703L0M1.IMG"),
        ("größe 漢.svf", "größe 漢.svf"),
        (os.fsdecode(b"caf\xe9.img"), "caf\\xe9.img"),
        ("a\nb\x1b[2J\u202egmi.img", "a\\nb\\x1b[2J\\u202egmi.img"),
    ],
)
def test_names_are_plain_text(name, plain):
    assert plain_name(name) == plain
