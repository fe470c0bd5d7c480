"""Plain (reflected) Gray code: neighbouring words differ by one bit."""

import numpy as np

from reconstruction.arrays import BoolArray, IntArray
from reconstruction.words import WORDS, WordEncoding, gray_word


class ReflectedWord(WordEncoding):
    """g = w ^ (w >> 1)."""

    name = "reflected"
    summary = "plain Gray code"
    is_order_checked = True
    has_spare_bits = True

    def shown(self, words: IntArray, bits: int) -> IntArray:
        """Return the Gray words."""
        return gray_word(words)

    def binary(self, bits: BoolArray) -> BoolArray:
        """Return the exclusive or of each bit with all coarser ones; without a table."""
        return np.asarray(np.logical_xor.accumulate(bits))


WORDS.register(ReflectedWord())
