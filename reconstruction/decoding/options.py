"""How to filter and what to mask; the one place of these defaults, in need of no compiled code."""

from dataclasses import dataclass

from reconstruction.checks import require_integer, require_number


@dataclass(frozen=True)
class DecodeOptions:
    """How to filter and what to mask.

    Parameters
    ----------
    filter_taps : width of the Gaussian on the coordinate, px; 0 switches it off. An even width is
        averaged over both anchors (one tap more), so that nothing shifts by half a pixel. What it
        takes from relief is given back, see `smoothing`
    filter_sigma_px : its standard deviation; the paper states only 8 x 8
    min_modulation_dn : mask a smaller fringe contrast; None: only the next limit
    max_phase_sigma_rad : mask a larger predicted phase sigma of the single pixel
    dark_sigmas : white must exceed black by this many sigmas of their difference
    gray_sigmas : a Gray level closer to its threshold than this many sigmas is doubtful
    max_condition : frames of a pixel that are clipped or lost are left out of its fit; mask a
        larger condition number of what remains (1: all frames are there)
    max_order_error : mask a larger probability of a wrong fringe order; 1: only certain errors
    """

    filter_taps: int = 8
    filter_sigma_px: float = 1.5
    min_modulation_dn: float | None = None
    max_phase_sigma_rad: float = 0.1
    dark_sigmas: float = 3.0
    gray_sigmas: float = 4.0
    max_condition: float = 100.0
    max_order_error: float = 0.01

    def __post_init__(self) -> None:
        require_integer("filter_taps", self.filter_taps, 0, 63)
        require_number("filter_sigma_px", self.filter_sigma_px, 0.0, open_low=True)
        if self.min_modulation_dn is not None:
            require_number("min_modulation_dn", self.min_modulation_dn, 0.0)
        require_number("max_phase_sigma_rad", self.max_phase_sigma_rad, 0.0, open_low=True)
        require_number("dark_sigmas", self.dark_sigmas, 0.0)
        require_number("gray_sigmas", self.gray_sigmas, 0.0)
        require_number("max_condition", self.max_condition, 1.0)
        require_number("max_order_error", self.max_order_error, 0.0, 1.0)
