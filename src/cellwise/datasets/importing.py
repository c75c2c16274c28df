"""A folder or archive of a public data set to tidy parquet with a catalogue."""

from __future__ import annotations

import json
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellwise.data import CATALOGUE
from cellwise.datasets.fetching import digest_of, registered
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.logs import CellLog, read_log, write_log
from cellwise.notices import texts

Progress = Callable[[str, int, int], None]

# What a path says of the test, the first that fits; people name files freely.
KINDS = (
    ("hppc", r"hppc|pulse"),
    ("ocv", r"ocv|c[_-]?20(?!\d)|low.?current|incremental"),
    (
        "drive",
        r"us06|udds|hwf|la92|fuds|bjdst|(?<![a-z])dst|(?<![a-z])nn(?![a-z])|"
        r"cycle[_ -]?\d|mixed|dyn|drive",
    ),
    ("charge", r"charge(?!_dis)|(?<![a-z])chg"),
    ("capacity", r"cap|dis|[\d.]+c(?![a-z])"),
)
TEMPERATURE = (
    re.compile(r"(?<![A-Za-z0-9])(?P<minus>[nNmM-]?)(?P<value>\d{1,2})\s?_?(?:deg|°)\s?_?C", re.I),
    re.compile(r"(?<![A-Za-z0-9.])(?P<minus>[nNmM-]?)(?P<value>\d{1,2})C(?![A-Za-z])"),
    re.compile(r"(?<![A-Za-z0-9])(?P<minus>[NnPp])(?P<value>\d{2})(?![A-Za-z0-9])"),
)
OTHER_FILES = (".pdf", ".md", ".txt", ".doc", ".docx", ".m", ".png", ".jpg", ".jpeg", ".html")


@dataclass(frozen=True)
class Imported:
    """What an import made: entries of the catalogue, and files that are no logs with the reason."""

    folder: Path
    entries: tuple[dict[str, Any], ...]
    left_out: tuple[tuple[str, str], ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "folder": str(self.folder),
            "imported": list(self.entries),
            "left_out": [{"file": name, "reason": reason} for name, reason in self.left_out],
        }


def import_dataset(
    name: str, source: Path | str, out: Path | str, progress: Progress | None = None
) -> Imported:
    """Read every log of a folder or a zip archive, write them tidy, and say what each is.

    Parameters
    ----------
    name : str            of the registry
    source : path         folder or zip archive as downloaded; archives within are opened too
    out : path            a folder that is not there yet, or is empty

    Raises
    ------
    InputError            no such original, folder or archive; not one log in it; a folder that
                          holds something
    """
    original = registered(name)
    place, target = Path(source), Path(out)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"'{out}', which holds something", "an empty folder", "Name another one.")
    with tempfile.TemporaryDirectory() as room:
        files = list(_files(place, Path(room)))
        entries: list[dict[str, Any]] = []
        left_out: list[tuple[str, str]] = []
        for done, (shown, path) in enumerate(files):
            if progress is not None:
                progress(shown, done, len(files))
            try:
                log = read_log(path, name=Path(shown).stem)
            except InputError as error:
                left_out.append((shown, error.text))
                continue
            entries.append(_write(original, shown, path, log, target, entries))
    if not entries:
        reason = f" ({left_out[0][0]}: " + left_out[0][1] + ")" if left_out else ""
        raise InputError(
            f"not one log in '{source}'" + reason,
            f"the files of {original['cell']} as downloaded",
            f"They are at {original['url']}.",
        )
    write_atomically(target / CATALOGUE, catalogue_text(original, entries))
    return Imported(target, tuple(entries), tuple(left_out))


def _files(place: Path, room: Path, prefix: str = "") -> Iterator[tuple[str, Path]]:
    """Name below the source and place of every file; archives are unpacked into ``room``."""
    if place.is_file() and zipfile.is_zipfile(place):
        inner = Path(tempfile.mkdtemp(dir=room))
        try:
            with zipfile.ZipFile(place) as packed:
                packed.extractall(inner)  # names that lead elsewhere stay within
        except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError) as error:
            raise InputError(
                f"a damaged archive '{place.name}' ({error})", "a whole one", "Download it again."
            ) from None
        place = inner
    if not place.is_dir():
        raise InputError(
            f"no folder or zip archive '{place}'", "what was downloaded", "Check the path."
        )
    for path in sorted(place.rglob("*")):
        shown, suffix = path.relative_to(place), path.suffix.casefold()
        if not path.is_file() or any(p.startswith((".", "__MACOSX")) for p in shown.parts):
            continue
        if suffix == ".zip" and zipfile.is_zipfile(path):
            yield from _files(path, room, f"{prefix}{shown.as_posix()}/")
        elif suffix not in OTHER_FILES:
            yield prefix + shown.as_posix(), path


def _write(
    original: dict[str, Any],
    shown: str,
    path: Path,
    log: CellLog,
    target: Path,
    before: list[dict[str, Any]],
) -> dict[str, Any]:
    """Write one log; its entry of the catalogue."""
    target.mkdir(parents=True, exist_ok=True)
    name = f"{original['name']}_{plain(shown)}"
    taken = {entry["name"] for entry in before}
    while name in taken:
        name += "_"
    written = write_log(log, target / f"{name}.parquet")
    temperature = temperature_of(shown)
    if temperature is None and log.temperature_C is not None:
        known = sorted(t for t in log.temperature_C.tolist() if t == t)
        temperature = round(known[len(known) // 2], 1) if known else None
    return {
        "name": name,
        "file": written.name,
        "cell": original["cell"],
        "chemistry": original["chemistry"],
        "nominal_Ah": original["nominal_Ah"],
        "window_V": original["window_V"],
        "kind": kind_of(shown),
        "temperature_C": temperature,
        "rows": len(log),
        "duration_s": log.duration_s,
        "bytes": written.stat().st_size,
        "sha256": digest_of(written, "sha256"),
        "source": shown,
        "source_sha256": digest_of(path, "sha256"),
        "format": log.format,
        "doi": original["doi"],
        "licence": original["licence"],
        "notices": texts(log.notices),
    }


def kind_of(path: str) -> str:
    """What a path says of the test: hppc, ocv, drive, charge, capacity, else other."""
    name_text = Path(path).name.casefold()
    for text in (name_text, path.casefold()):
        for kind, pattern in KINDS:
            if re.search(pattern, text):
                return kind
    return "other"


def temperature_of(path: str) -> float | None:
    """What a path says of the temperature [degC]: ``n10degC``, ``-10degC``, ``25C``, ``P45``."""
    # The clearer ways of writing first, wherever they stand: 1C is a rate, too.
    for pattern in TEMPERATURE:
        for text in (Path(path).name, path):
            found = pattern.search(text)
            if found:
                cold = found["minus"].casefold() in ("n", "m", "-")
                return (-1.0 if cold else 1.0) * float(found["value"])
    return None


def plain(path: str) -> str:
    """A path as one word of small letters, digits and underscores."""
    stem = re.sub(r"\.(csv|mat|xlsx?|txt|parquet|gz|zip)(?=$|/)", "", path, flags=re.I)
    return re.sub(r"[^a-z0-9]+", "_", stem.casefold()).strip("_")


def catalogue_text(original: dict[str, Any], entries: list[dict[str, Any]]) -> str:
    """The catalogue as TOML, in the form of the embedded data's."""
    lines = [
        f"# {original['cell']}, {original['lab']}. Imported by cellwise; do not edit.",
        "# kind and temperature_C are read off the file's name, else off its own measurement.",
    ]
    for entry in entries:
        lines += ["", "[[dataset]]"]
        # Strings and lists of JSON are TOML's too.
        lines += [f"{k} = {json.dumps(v)}" for k, v in entry.items() if v is not None]
    return "\n".join(lines) + "\n"
