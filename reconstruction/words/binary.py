"""Binary words: the bits of the number itself."""

from reconstruction.arrays import BoolArray, IntArray
from reconstruction.words import WORDS, WordEncoding


class BinaryWord(WordEncoding):
    """The word itself."""

    name = "binary"
    summary = "bits of the word itself"
    is_order_checked = True

    def shown(self, words: IntArray, bits: int) -> IntArray:
        """Return the words."""
        return words

    def binary(self, bits: BoolArray) -> BoolArray:
        """Return the bits."""
        return bits


WORDS.register(BinaryWord())
