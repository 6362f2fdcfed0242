"""Messages of errors are one line, whatever they quote."""

import pytest

from ruffini.errors import InputError, NoDeviceError


@pytest.mark.parametrize(
    ("quoted", "shown"),
    [("zo\x18", "zo\\x18"), ("a\nb\x0cc\u2028d", "a\\nb\\x0cc\\u2028d"), ("\udcff", "\\udcff"), ("µm, ü", "µm, ü")],
    ids=ascii,
)
def test_what_does_not_print_is_escaped(quoted, shown):
    assert str(InputError(f"the schema cannot be read: {quoted}")) == f"the schema cannot be read: {shown}"
    assert len(str(NoDeviceError(quoted)).splitlines()) == 1
