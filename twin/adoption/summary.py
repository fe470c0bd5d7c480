"""Summary of an adopted rig in a few lines: determined fields, assumed fields, further captures."""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from reconstruction.errors import counted
from twin.adoption.adopt import Adopted
from twin.adoption.findings import ASSUMED, DEVICES, NEEDS, rows_of

MOST_LINES = 9
"""Most lines of a summary; all fields and remarks are in the files of the rig."""
_MOST_REMARKS, _MOST_DATA = 2, 4
Field = tuple[str, Any, Any, str]


def summary_of(adopted: Adopted) -> list[str]:
    """Return lines of text: estimates with interval, numbers of fields by source, and remarks.

    The line on assumed fields names the captures that would determine them.
    """
    fields = [row for row in rows_of(adopted.tables) if row[0].split(".")[0] in DEVICES]
    remarks = [f"note: {note}" for note in adopted.notes[:_MOST_REMARKS]]
    more = len(adopted.notes) - len(remarks)
    remarks += [f"{counted(more, 'more note')} in result.json"] if more else []
    head = [*_by_source(fields), *_further(fields)]
    return [*_estimates(fields, MOST_LINES - len(head) - len(remarks)), *head, *remarks]


def _estimates(fields: Iterable[Field], most: int) -> list[str]:
    """Return one line for each field with an estimated interval, at most `most`."""
    lines = [
        f"{path} = {value:.5g} (95 %: {limits[0]:.5g} to {limits[1]:.5g})"
        for path, value, limits, source in fields
        if limits and isinstance(value, float) and not source.startswith(ASSUMED)
    ]
    if len(lines) <= most:
        return lines
    return [*lines[: most - 1], f"{counted(len(lines) - most + 1, 'more estimate')} in rig.toml"]


def _by_source(fields: Iterable[Field]) -> Iterator[str]:
    counts = Counter(source.partition(":")[0] for *_, source in fields)
    assumed = counts.pop(ASSUMED, 0)
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    yield f"{counted(sum(counts.values()), 'field')} determined ({kinds}), {assumed} assumed"


def _further(fields: Iterable[Field]) -> Iterator[str]:
    """Yield one line with the captures that would determine assumed fields, the most useful first.

    The most useful capture is the one that determines most fields. Text after a colon, which is a
    remark on one of the fields, is left out.
    """
    needed = Counter(
        source.partition(NEEDS)[2].partition(":")[0]
        for *_, source in fields
        if source.startswith(ASSUMED) and NEEDS in source
    )
    ranked = [f"{data} ({counted(n, 'field')})" for data, n in needed.most_common(_MOST_DATA)]
    if ranked:
        yield f"to determine more: {'; '.join(ranked)}"
