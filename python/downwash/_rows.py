"""Rows of a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for index, inner in enumerate(value):
            yield from _flat(f"{prefix}.{index}", inner)
    else:
        yield prefix, value


class Rows(list[dict[str, Any]]):
    """Rows as dictionaries; tables inside them are columns with a dot when made a table."""

    def flat(self) -> list[dict[str, Any]]:
        """The rows without tables inside: ``effects.rotor_drag.d_xy`` is a column."""
        return [dict(_flat("", row)) for row in self]

    def to_pandas(self) -> Any:
        """A pandas DataFrame."""
        import pandas

        return pandas.DataFrame(self.flat())

    def to_arrow(self) -> Any:
        """A pyarrow Table."""
        import pyarrow

        return pyarrow.Table.from_pylist(self.flat())

    def _repr_html_(self) -> str | None:
        try:
            found: str = self.to_pandas()._repr_html_()
        except ImportError:
            return None
        return found
