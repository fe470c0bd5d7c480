"""A word encoding from outside: neighbouring words are shown far from each other.

The word is multiplied by an odd number near 0.618 of the number of words, which is one-to-one. No
frame has wide stripes.
"""

from reconstruction.words import WORDS, WordEncoding


class ScatteredWord(WordEncoding):
    """Multiples of the golden section."""

    name = "scattered"
    summary = "bits of the word times the golden section"

    def shown(self, words, bits):
        """Return the numbers whose bits are shown, most significant bit first, for words (n,)."""
        return words * (int(0.618 * 2**bits) | 1) % 2**bits


SCATTERED = WORDS.register(ScatteredWord())
