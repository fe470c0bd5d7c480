"""Order in which the cases of a study are computed, so that consecutive cases share stages.

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
    """Sort cases so that consecutive cases share stages; return them with their sort keys.

    Cases are sorted by method, because methods share few results. Then they are sorted by the
    values of the fields that each stage reads, first stage first. Equal values have the rank of
    their first occurrence.
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
    """Split sorted cases into several batches per worker, preferably between different stages.

    The last batches have half the size, so that the workers end at about the same time. Take the
    first stage in which any cases differ. Cases that share this stage are put into one batch if
    there are enough such groups, because another worker would have to compute the stage again. An
    example is the calibration of a sensor.
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
    """Return the size of the largest group of cases that share the first differing stage."""
    for level in range(len(keyed[0][0])):
        sizes = Counter(key[level] for key, _ in keyed)
        if len(sizes) > 1:
            return max(sizes.values())
    return 1


def _cut(keyed: list[tuple[Key, Case]], level: int, most: int) -> list[list[tuple[Key, Case]]]:
    """Split sorted cases into parts of at most `most` cases, preferably between different stages.

    Stages before number `level` are equal for all cases. Small neighbouring parts are joined.
    """
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
