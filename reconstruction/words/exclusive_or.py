"""XOR codes: Gray code with its coarser bits combined with a fine one.

No frame has stripes wider than a few words: light between surfaces is then similar in all frames
(Gupta et al., Int. J. Comput. Vis. 102, 33 (2013)).
"""

from reconstruction.arrays import IntArray
from reconstruction.words import WORDS, WordEncoding, gray_word


class ExclusiveOrWord(WordEncoding):
    """All bits coarser than bit `place`, counted from the last, are combined with that bit.

    This hides the order of all frames but one, so that `is_order_checked` is False.
    """

    def __init__(self, name: str, place: int, order: str) -> None:
        self.name, self._place = name, place
        self.summary = f"Gray code with its coarser bits exclusive-or the {order}"

    def shown(self, words: IntArray, bits: int) -> IntArray:
        """Return the Gray words with their coarser bits inverted where the bit is 1."""
        gray = gray_word(words)
        coarser = 2**bits - 2 ** (self._place + 1)
        return gray ^ ((gray >> self._place) & 1) * coarser if coarser > 0 else gray


WORDS.register(ExclusiveOrWord("xor_02", 0, "last"))
WORDS.register(ExclusiveOrWord("xor_04", 1, "last but one"))
