"""From arrays back to names."""

from __future__ import annotations

from jaxtyping import Array


def by_name(names: tuple[tuple[str, ...], ...], tables: tuple[Array, ...], axis: int = 0) -> dict[str, Array]:
    """{name: row}, for tables of rows along `axis` and the names of their rows."""
    lead = (slice(None),) * axis
    return {name: table[(*lead, i)] for group, table in zip(names, tables, strict=True) for i, name in enumerate(group)}
