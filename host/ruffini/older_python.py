"""What Python 3.10 lacks, under the names that newer ones have."""

import sys

if sys.version_info >= (3, 11):
    from datetime import UTC  # novm
    from enum import StrEnum  # novm
    from typing import Self  # novm

    import tomllib
else:
    from datetime import timezone
    from enum import Enum

    import tomli as tomllib
    from typing_extensions import Self

    UTC = timezone.utc

    class StrEnum(str, Enum):
        __str__ = str.__str__


__all__ = ["UTC", "Self", "StrEnum", "tomllib"]
