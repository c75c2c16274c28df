"""Fetch a public data set; a file is there only when its checksum is right."""

from __future__ import annotations

import hashlib
import http.client
import json
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple
from urllib.error import URLError
from urllib.parse import quote, urljoin
from urllib.request import Request, urlopen

from cellwise.data import list_originals
from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.wording import arg

TIMEOUT_S = 60.0  # without an answer
MOST_LISTING_BYTES = 64_000_000

# Called with the file's name, the bytes that are here, and all it has (None: not stated).
Progress = Callable[[str, int, int | None], None]


class RemoteFile(NamedTuple):
    """A file to fetch; ``algorithm`` and ``checksum`` say what it must hold."""

    name: str
    url: str
    algorithm: str
    checksum: str
    size: int | None


def registered(name: str) -> dict[str, Any]:
    """The registry's entry of that name.

    Raises
    ------
    InputError        no such entry
    """
    known = {str(e["name"]): e for e in list_originals()}
    if name not in known:
        raise InputError(f"'{name}'", f"one of {', '.join(known)}", "See `cellwise data list`.")
    return known[name]


def fetch_dataset(
    name: str, out: Path | str, listing: str | None = None, progress: Progress | None = None
) -> list[Path]:
    """Download the files of a public original that are not there yet.

    Parameters
    ----------
    name : str              of the registry
    out : path              folder; its parent is there
    listing : str or None   address of the list of files; None: the registry's
    progress : callable

    Returns
    -------
    list of Path            every file of the original, fetched now or before

    Raises
    ------
    InputError              no such original, nowhere to fetch it from, no answer, a file whose
                            checksum is not the listed one (it is not kept)
    """
    address = listing or registered(name).get("listing")
    if not address:
        raise InputError(
            f"no list of files with checksums for '{name}'",
            "an original whose repository gives one",
            f"Download it by hand from {registered(name)['url']} and use `data import`, or give "
            + arg("listing", letter="URL")
            + ".",
        )
    with _open(str(address)) as answer:
        text = answer.read(MOST_LISTING_BYTES).decode("utf-8", "replace")
    files = read_listing(text, str(address))
    folder = made_folder(out)
    return [_fetch(file, folder, progress) for file in files]


def _fetch(file: RemoteFile, folder: Path, progress: Progress | None) -> Path:
    target = folder / file.name
    if target.is_file() and digest_of(target, file.algorithm) == file.checksum:
        return target
    target.parent.mkdir(parents=True, exist_ok=True)

    def download(place: Path) -> None:
        digest = hashlib.new(file.algorithm)
        done = 0
        with _open(file.url) as answer, place.open("wb") as local:
            while piece := _piece(answer, file):
                digest.update(piece)
                done += local.write(piece)
                if progress is not None:
                    progress(file.name, done, file.size)
        if digest.hexdigest() != file.checksum:
            raise InputError(
                f"'{file.name}' with {file.algorithm} {digest.hexdigest()[:16]}..., {done} bytes",
                f"{file.algorithm} {file.checksum[:16]}..., as its repository lists",
                "It was not kept. Fetch again; if it stays so, the record has changed.",
            )

    return write_atomically(target, download)


def _piece(answer: Any, file: RemoteFile) -> bytes:
    try:
        return bytes(answer.read(1_000_000))
    except (OSError, http.client.HTTPException) as error:
        raise InputError(
            f"a connection that broke within '{file.name}' ({error})",
            "the whole file",
            "Fetch again: what is whole is not fetched twice.",
        ) from None


def _open(url: str) -> Any:
    if not url.startswith(("https://", "http://")):
        raise InputError(
            f"the address '{url}'", "https://...", "Give " + arg("listing", letter="URL") + "."
        )
    try:
        # Some repositories refuse Python's own name.
        return urlopen(Request(url, headers={"User-Agent": "cellwise"}), timeout=TIMEOUT_S)
    except (URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(
            f"no answer from '{url}' ({reason})",
            "a file there",
            "Check the network, or download by hand and use `data import`.",
        ) from None


def digest_of(path: Path, algorithm: str) -> str:
    """Checksum of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, algorithm).hexdigest()


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
            said = entry["content_details"]
            name, address, size = entry["filename"], said["download_url"], said.get("size")
            algorithm, checksum = "sha256", said["sha256_hash"]
        else:
            name, links, size = entry["key"], entry["links"], entry.get("size")
            address = links.get("self") or links["content"]
            algorithm, _, checksum = str(entry["checksum"]).rpartition(":")
        return RemoteFile(str(name), str(address), algorithm or "md5", str(checksum), size)
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
            place = urljoin(url, quote(name))
            found.append(RemoteFile(name, place, "sha256", checksum.lower(), None))
    return found
