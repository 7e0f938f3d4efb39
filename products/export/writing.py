"""Write an export: update a folder, or replace a ZIP archive.

`SHA256SUMS` lists every file with its checksum, as `sha256sum --check` reads it. It also lists the
files of an earlier export: in a folder only files with other checksums are written, and files that
are no longer part of the export are removed; files of other origin are left unchanged. Before a
file changes it is removed from the list, so that an interrupted export is completed by the next;
files changed after the list are written again. An archive is written beside its target and renamed
when it is complete.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from solmap.products.errors import ProductError
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

SUMS = "SHA256SUMS"
_CHUNK = 1 << 20
_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of all members of an archive: equal files give equal archives."""
_COMPRESSED = {".tif", ".glb", ".3tz", ".png", ".qgz", ".pdf"}
"""Suffixes of files that are stored without compression."""


@dataclass(frozen=True, slots=True)
class ExportFile:
    """A file of an export."""

    name: str
    """Its path in the export, parts separated by `/`."""
    source: ProductRef | Path
    """The product, or the file, of which it is a copy."""
    sha256: str

    @classmethod
    def of(cls, name: str, source: ProductRef | Path, store: ProductStore) -> ExportFile:
        """A file with its checksum; that of a product is in its provenance."""
        if isinstance(source, ProductRef):
            return cls(name, source, str(store.provenance(source)["sha256"]))
        with source.open("rb") as file:
            return cls(name, source, hashlib.file_digest(file, "sha256").hexdigest())

    def chunks(self, store: ProductStore) -> Iterator[bytes]:
        """Its bytes, in pieces.

        Raises:
            ProductError: they do not match the checksum.
        """
        digest = hashlib.sha256()
        for chunk in self._read(store):
            digest.update(chunk)
            yield chunk
        if digest.hexdigest() != self.sha256:
            raise ProductError(
                f"{self.name}: the product in the store is broken; find it with `solmap check`"
            )

    def _read(self, store: ProductStore) -> Iterator[bytes]:
        if isinstance(self.source, ProductRef):
            yield from store.chunks(self.source, 0, store.size(self.source))
            return
        with self.source.open("rb") as file:
            while chunk := file.read(_CHUNK):
                yield chunk


@dataclass(frozen=True, slots=True)
class Written:
    """Result of an export."""

    written: int
    """Files that are new or changed."""
    unchanged: int
    removed: int
    """Files of an earlier export that are no longer part of it."""


def sums_text(sums: Mapping[str, str]) -> str:
    """`SHA256SUMS`: a checksum and a name in each line, by name."""
    return "".join(f"{sums[name]}  {name}\n" for name in sorted(sums))


def read_sums(text: str) -> dict[str, str]:
    """The inverse of `sums_text`; other lines are ignored."""
    pairs = (line.split("  ", 1) for line in text.splitlines() if "  " in line)
    return {name: digest for digest, name in pairs}


def check_target(target: Path, store: ProductStore) -> None:
    """Reject a target that an export must not overwrite.

    Raises:
        ProductError: it is in the store, is of another type, or has other content.
    """
    if target.resolve().is_relative_to(store.root):
        raise ProductError(f"{target} is in the store; name a folder or .zip file outside of it")
    if is_archive(target):
        if target.is_dir():
            raise ProductError(f"{target} is a folder; name another .zip file")
        return
    if target.exists() and not target.is_dir():
        raise ProductError(f"{target} is a file; name a folder, or a file that ends in .zip")
    if target.is_dir() and not (target / SUMS).is_file() and any(target.iterdir()):
        raise ProductError(f"{target} contains files and no earlier export; name an empty folder")


def is_archive(target: Path) -> bool:
    """Whether the target is a ZIP archive."""
    return target.suffix.lower() == ".zip"


def write_folder(target: Path, files: Sequence[ExportFile], store: ProductStore) -> Written:
    """Update a folder with some files."""
    target.mkdir(parents=True, exist_ok=True)
    sums = {file.name: file.sha256 for file in files}
    listed = target / SUMS
    before = read_sums(listed.read_text(encoding="utf-8")) if listed.is_file() else {}
    kept = {
        name: digest
        for name, digest in before.items()
        if sums.get(name) == digest and _is_older(target / name, listed)
    }
    if kept != before:
        _replace(listed, [sums_text(kept).encode()])
    changed = [file for file in files if file.name not in kept]
    for file in changed:
        place = target / file.name
        place.parent.mkdir(parents=True, exist_ok=True)
        _replace(place, file.chunks(store))
    gone = [name for name in before if name not in sums]
    for name in gone:
        _remove(target, name)
    if kept != sums:
        _replace(listed, [sums_text(sums).encode()])
    return Written(len(changed), len(kept), len(gone))


def _is_older(path: Path, listed: Path) -> bool:
    """Whether a file exists and has not been changed since the list was written."""
    return path.is_file() and path.stat().st_mtime_ns <= listed.stat().st_mtime_ns


def _replace(path: Path, chunks: Iterable[bytes]) -> None:
    """Write a file beside its target and rename it when complete."""
    draft = path.with_name(f".{path.name}.draft")
    try:
        with draft.open("wb") as file:
            for chunk in chunks:
                file.write(chunk)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _remove(target: Path, name: str) -> None:
    """Remove a file of an earlier export, and folders that it leaves empty."""
    path = (target / name).resolve()
    if not path.is_relative_to(target.resolve()):
        return  # not part of an export
    path.unlink(missing_ok=True)
    for folder in path.parents:
        if folder == target.resolve() or any(folder.iterdir()):
            return
        folder.rmdir()


def write_archive(target: Path, files: Sequence[ExportFile], store: ProductStore) -> Written:
    """Write an archive with some files in one folder, unless it contains them already."""
    sums = {file.name: file.sha256 for file in files}
    folder, text = target.stem, sums_text(sums)
    before = _sums_of_archive(target, folder)
    if before == sums:
        return Written(0, len(files), 0)
    target.parent.mkdir(parents=True, exist_ok=True)
    draft = target.with_name(f".{target.name}.draft")
    try:
        with zipfile.ZipFile(draft, "w") as archive:
            for file in sorted(files, key=lambda file: file.name):
                _pack(archive, f"{folder}/{file.name}", file.chunks(store))
            _pack(archive, f"{folder}/{SUMS}", [text.encode()])
        with draft.open("rb") as whole:
            os.fsync(whole.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)
    return Written(len(files), 0, len(before.keys() - sums.keys()))


def _pack(archive: zipfile.ZipFile, name: str, chunks: Iterable[bytes]) -> None:
    member = zipfile.ZipInfo(name, _DATE)
    is_packed = Path(name).suffix in _COMPRESSED
    member.compress_type = zipfile.ZIP_STORED if is_packed else zipfile.ZIP_DEFLATED
    member.external_attr = 0o644 << 16
    into: BinaryIO
    with archive.open(member, "w", force_zip64=True) as into:  # type: ignore[assignment]
        for chunk in chunks:
            into.write(chunk)


def _sums_of_archive(target: Path, folder: str) -> dict[str, str]:
    """Content of an archive, from its own list; empty if it cannot be read."""
    try:
        with zipfile.ZipFile(target) as archive:
            return read_sums(archive.read(f"{folder}/{SUMS}").decode())
    except (OSError, KeyError, zipfile.BadZipFile, UnicodeDecodeError):
        return {}
