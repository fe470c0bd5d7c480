from reconstruction.decoding.decode import DecodeOptions
from twin.config import decode_settings


def test_the_filter_has_one_default():
    """Why: experiment and command line had a default of 1.5 px, the decoder 1.55 px."""
    settings, options = decode_settings(), DecodeOptions()
    assert settings.filter_taps == options.filter_taps == 8
    assert settings.filter_sigma_px == options.filter_sigma_px == 1.5
