"""Fetch a public original; a file is there only when its checksum is right."""

from __future__ import annotations

import hashlib
import http.client
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

from cellwise.data import list_originals
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.originals.listing import RemoteFile, read_listing

PIECE_BYTES = 1 << 20
TIMEOUT_S = 60.0
MOST_LISTING_BYTES = 1 << 26

# Called with the file's name, the bytes that are here, and all it has (None: not stated).
Progress = Callable[[str, int, int | None], None]


def find_original(name: str) -> dict[str, Any]:
    """The registry's entry of that name.

    Raises
    ------
    InputError        no such entry
    """
    known = {str(e["name"]): e for e in list_originals()}
    if name not in known:
        raise InputError(f"'{name}'", f"one of {', '.join(known)}", "See `cellwise data list`.")
    return known[name]


def fetch_original(
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
    address = listing or find_original(name).get("listing")
    if not address:
        raise InputError(
            f"no list of files with checksums for '{name}'",
            "an original whose repository gives one",
            f"Download it by hand from {find_original(name)['url']} and use `data import`, or give "
            "`listing=URL`.",
        )
    with _open(str(address)) as answer:
        text = answer.read(MOST_LISTING_BYTES).decode("utf-8", "replace")
    files = read_listing(text, str(address))
    folder = Path(out)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            f"'{out}', which cannot be made ({error.strerror})", "a folder", "Choose another."
        ) from None
    return [_fetch(file, folder, progress) for file in files]


def _fetch(file: RemoteFile, folder: Path, progress: Progress | None) -> Path:
    target = folder / file.name
    if target.is_file() and _digest(target, file.algorithm) == file.checksum:
        return target
    target.parent.mkdir(parents=True, exist_ok=True)

    def download(place: Path) -> None:
        digest = hashlib.new(file.algorithm)
        done = 0
        with _open(file.url) as answer, place.open("wb") as local:
            while piece := _read(answer, file):
                digest.update(piece)
                local.write(piece)
                done += len(piece)
                if progress is not None:
                    progress(file.name, done, file.size)
        if digest.hexdigest() != file.checksum:
            raise InputError(
                f"'{file.name}' with {file.algorithm} {digest.hexdigest()[:16]}..., {done} bytes",
                f"{file.algorithm} {file.checksum[:16]}..., as its repository lists",
                "It was not kept. Fetch again; if it stays so, the record has changed.",
            )

    return write_atomically(target, download)


def _read(answer: Any, file: RemoteFile) -> bytes:
    try:
        piece: bytes = answer.read(PIECE_BYTES)
    except (OSError, http.client.HTTPException) as error:
        raise InputError(
            f"a connection that broke within '{file.name}' ({error})",
            "the whole file",
            "Fetch again: what is whole is not fetched twice.",
        ) from None
    return piece


def _open(url: str) -> Any:
    if not url.startswith(("https://", "http://")):
        raise InputError(f"the address '{url}'", "https://...", "Give `listing=URL`.")
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


def _digest(path: Path, algorithm: str) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, algorithm).hexdigest()
