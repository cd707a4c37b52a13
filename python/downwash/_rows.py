"""Rows of a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
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
    """Rows as dictionaries. In a table, nested tables become columns with dotted names."""

    metadata: dict[str, str]
    """Metadata of the table."""

    def __init__(self, rows: Iterable[dict[str, Any]] = ()) -> None:
        super().__init__(rows)
        self.metadata = {}

    def flat(self) -> list[dict[str, Any]]:
        """The rows without nested tables, with dotted keys such as ``effects.rotor_drag.d_xy``."""
        return [dict(_flat("", row)) for row in self]

    def to_pandas(self) -> Any:
        """A pandas DataFrame."""
        import pandas

        return pandas.DataFrame(self.flat())

    def to_arrow(self) -> Any:
        """A pyarrow Table."""
        import pyarrow

        rows = self.flat()
        # From a list of rows, pyarrow would take only the columns of the first.
        names = dict.fromkeys(name for row in rows for name in row)
        columns = {name: [row.get(name) for row in rows] for name in names}
        return pyarrow.table(columns).replace_schema_metadata(self.metadata or None)

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Writes a Parquet file with pyarrow."""
        import pyarrow.parquet

        pyarrow.parquet.write_table(self.to_arrow(), path)

    def _repr_html_(self) -> str | None:
        try:
            found: str = self.to_pandas()._repr_html_()
        except ImportError:
            return None
        return found
