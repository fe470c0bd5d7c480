"""Encodings of code words as bits. One kind per module, registered in `WORDS`.

A kind defines which number is shown, bit by bit, for each word. The decoder inverts it by a table,
so that any one-to-one encoding can be added as one file. Minimal example:

    class OneMore(WordEncoding):
        name, summary = "one_more", "the next word, modulo their number"

        def shown(self, words, bits):
            return (words + 1) % 2**bits

    WORDS.register(OneMore())
"""

import numpy as np

from reconstruction.arrays import BoolArray, IntArray
from reconstruction.errors import InputError
from reconstruction.registry import Registry


class WordEncoding:
    """An encoding of words as bits. A kind sets `name`, `summary` and its own `shown`.

    Attributes
    ----------
    name : value of the key `word`
    summary : one line of documentation
    is_order_checked : whether neighbouring pixels show if two frames of a capture are exchanged
    has_spare_bits : whether a list of frames may omit the finest bits, if the fringes do not need
        them
    """

    name: str
    summary: str
    is_order_checked: bool = False
    has_spare_bits: bool = False

    def shown(self, words: IntArray, bits: int) -> IntArray:
        """Return the numbers that are shown for words (n,) of `bits` bits; one-to-one."""
        raise NotImplementedError(f"word encoding {self.name!r} has no function shown")

    def binary(self, bits: BoolArray) -> BoolArray:
        """Return the bits of a word before encoding, from its bits as shown; (bit, ...).

        The most significant bit is the first.
        """
        places = np.arange(len(bits))[::-1]
        words = self.words_of(len(bits))[np.tensordot(2**places, bits, axes=1)]
        return np.asarray((words >> places.reshape(-1, *(1,) * words.ndim)) & 1, np.bool_)

    def words_of(self, bits: int) -> IntArray:
        """Return the word of each number that may be shown, (2^bits,).

        Raises
        ------
        InputError : two words are shown by the same bits
        """
        numbers = self.shown(np.arange(2**bits), bits)
        words = np.full(2**bits, -1)
        words[numbers] = np.arange(2**bits)
        if (words < 0).any():
            raise InputError(
                f"patterns word {self.name!r} shows two words of {bits} bits alike; its function"
                " shown must be one-to-one"
            )
        return words


WORDS: Registry[WordEncoding] = Registry("words", "reconstruction.words", lambda kind: kind.name)


def gray_word(words: IntArray) -> IntArray:
    """Return the plain Gray words of words (n,)."""
    return words ^ (words >> 1)
