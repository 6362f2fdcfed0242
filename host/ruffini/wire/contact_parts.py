"""Messages that stages add to a Contact, also of devices and recordings whose Contact has the numbers of all stages.

Such a former Contact has the fields of the stages' messages itself, with the same names. So it stands for each message
whose first field it sets.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from ruffini.wire.messages import Schema


@cache
def _first_fields() -> dict[str, str]:
    """Name of the first field of each stage's message, by its name in Contact: set if the stage reports something."""
    parts = Schema.own().new("Contact").DESCRIPTOR.fields
    return {part.name: part.message_type.fields_by_number[1].name for part in parts if part.message_type is not None}


def contact_part(contact: Any, name: str) -> Any:
    """A stage's message of a contact by its name in ruffini.proto, e.g. "slip"; None if nothing is reported.

    Fields that its schema does not have yet must be read with `number_of`.
    """
    own = contact.DESCRIPTOR.fields_by_name
    if name in own:
        return getattr(contact, name) if contact.HasField(name) else None
    first = own.get(_first_fields()[name])
    if first is None:
        return None
    value = getattr(contact, first.name)
    is_set = value if isinstance(value, int) else len(value)
    return contact if is_set else None


def number_of(message: Any, name: str) -> Any:
    """A number of a message, 0 if its schema is older than that field."""
    return getattr(message, name, 0)
