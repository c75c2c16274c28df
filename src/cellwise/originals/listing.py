"""What a repository of data says it holds: names, addresses, sizes, checksums."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import urljoin

from cellwise.errors import InputError


class RemoteFile(NamedTuple):
    """A file to fetch; ``algorithm`` and ``checksum`` say what it must hold."""

    name: str
    url: str
    algorithm: str
    checksum: str
    size: int | None


def read_listing(text: str, url: str) -> list[RemoteFile]:
    """Files of a listing.

    Mendeley Data lists files with ``content_details``, Zenodo with ``links`` and an ``md5:...``;
    anything else is taken for lines as `sha256sum` writes them, names beside the listing.

    Parameters
    ----------
    text : str      the listing
    url : str       where it came from

    Raises
    ------
    InputError      none of these, a file without a checksum, a name that leaves the folder
    """
    try:
        found = json.loads(text)
    except ValueError:
        files = _sums(text, url)
    else:
        entries = found.get("files") if isinstance(found, Mapping) else found
        files = [_entry(e, url) for e in entries] if isinstance(entries, list) else []
    if not files:
        raise InputError(
            f"no list of files at '{url}'",
            "the files of a Mendeley or Zenodo record, or lines of checksum and name",
            "Download the files by hand and import their folder.",
        )
    for file in files:
        parts = PurePosixPath(file.name).parts
        if not parts or file.name.startswith(("/", "\\")) or ".." in parts or "\\" in file.name:
            raise InputError(f"a file named '{file.name}' at '{url}'", "a plain name", "Beware.")
    return files


def _entry(entry: Any, url: str) -> RemoteFile:
    try:
        if "content_details" in entry:
            details = entry["content_details"]
            checksum = str(details["sha256_hash"])
            return RemoteFile(
                str(entry["filename"]), str(details["download_url"]), "sha256", checksum,
                details.get("size"),
            )  # fmt: skip
        algorithm, _, checksum = str(entry["checksum"]).rpartition(":")
        address = str(entry["links"].get("self") or entry["links"]["content"])
        return RemoteFile(
            str(entry["key"]), address, algorithm or "md5", checksum, entry.get("size")
        )
    except (KeyError, TypeError) as error:
        raise InputError(
            f"a file without {error} in the list at '{url}'",
            "name, address and checksum of every file",
            "Download the files by hand and import their folder.",
        ) from None


def _sums(text: str, url: str) -> list[RemoteFile]:
    found = []
    for line in text.splitlines():
        checksum, _, name = line.strip().partition(" ")
        name = name.strip().removeprefix("*")
        if len(checksum) == 64 and set(checksum.lower()) <= set("0123456789abcdef") and name:
            found.append(RemoteFile(name, urljoin(url, name), "sha256", checksum.lower(), None))
    return found
