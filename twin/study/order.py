"""The order in which cases of a study are computed, so that neighbours share their stages.

The cases that are computed first report which fields each stage reads. All further cases are sorted
by the values of these fields, first stage first. The order changes the run time, but no result.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from itertools import groupby

from twin.pipeline.memory import values_at
from twin.study.cases import Case
from twin.study.measuring import StageReads

Key = tuple[Hashable, ...]
BATCHES_PER_WORKER, LEAST_BATCHES_PER_WORKER = 6, 3


def in_sharing_order(cases: Sequence[Case], reads: StageReads) -> list[tuple[Key, Case]]:
    """Sort cases by the values that each stage reads, in the order of their first occurrence.

    Methods have stages of the same name, but share few results: cases are sorted by method first.
    """
    reads = ((("modality",),), *reads)
    ranks: list[dict[Hashable, int]] = [{} for _ in reads]
    keyed = []
    for case in cases:
        key = tuple(
            rank.setdefault(values_at(case.experiment, paths), len(rank))
            for rank, paths in zip(ranks, reads, strict=True)
        )
        keyed.append((key, case))
    return sorted(keyed, key=lambda item: item[0])


def batches_of(keyed: Sequence[tuple[Key, Case]], workers: int) -> list[list[Case]]:
    """Cut sorted cases into several batches per worker, preferably where stages differ.

    The last batches have half the size, so that workers end at about the same time. Cases that
    share the first stage in which any cases differ are in one batch if there are enough such
    groups: the next free worker may not have that stage's result, for example the sensor's
    calibration.
    """
    if not keyed:
        return []
    whole, fair = _largest_group(keyed), -(-len(keyed) // (workers * LEAST_BATCHES_PER_WORKER))
    whole = whole if workers > 1 and whole <= fair else 1
    most = max(whole, -(-len(keyed) // (workers * BATCHES_PER_WORKER)))
    parts, ending = _cut(list(keyed), 0, most), 2 * workers
    halves = [
        half for part in parts[-ending:] for half in _cut(part, 0, max(whole, -(-len(part) // 2)))
    ]
    return [[case for _, case in part] for part in parts[:-ending] + halves]


def _largest_group(keyed: Sequence[tuple[Key, Case]]) -> int:
    """Return the largest number of cases that share the first stage in which any cases differ."""
    for level in range(len(keyed[0][0])):
        sizes = Counter(key[level] for key, _ in keyed)
        if len(sizes) > 1:
            return max(sizes.values())
    return 1


def _cut(keyed: list[tuple[Key, Case]], level: int, most: int) -> list[list[tuple[Key, Case]]]:
    """Split by the stages from `level` on; join small neighbouring parts of a stage."""
    if len(keyed) <= most:
        return [keyed]
    if level == len(keyed[0][0]):
        return [keyed[i : i + most] for i in range(0, len(keyed), most)]
    by_level: Callable[[tuple[Key, Case]], Hashable] = lambda item: item[0][level]  # noqa: E731
    parts: list[list[tuple[Key, Case]]] = []
    for _, group in groupby(keyed, key=by_level):
        for part in _cut(list(group), level + 1, most):
            if parts and len(parts[-1]) + len(part) <= most:
                parts[-1] += part
            else:
                parts.append(part)
    return parts
