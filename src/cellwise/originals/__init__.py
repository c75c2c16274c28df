"""Public originals: fetched with their checksums, imported into the tidy form with a catalogue."""

from __future__ import annotations

from cellwise.originals.fetching import fetch_original
from cellwise.originals.importing import import_original

__all__ = ["fetch_original", "import_original"]
