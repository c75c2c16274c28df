"""What is printed and committed is what the printers print."""

from __future__ import annotations

import pytest

from cellwise.printing.__main__ import main
from cellwise.printing.outputs import OUTPUTS, SOURCE


def test_everything_is_as_printed(capsys):
    assert main(["--check"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_printed_file_says_so(name):
    head = (SOURCE / name).read_text(encoding="utf-8").split('"""')[1]
    assert "`python -m cellwise.printing`; do not edit." in head
