"""Commands: thin, no numerics."""

from cellwise.cli.main import main

__all__ = ["main"]
