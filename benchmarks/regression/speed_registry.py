"""Every speed figure, and the benchmark that measures it."""

from functools import partial

from benchmarks.regression.cases import Case
from benchmarks.regression.figures import Figure, Target
from benchmarks.regression.speed import field, over, reader

ratio = partial(Figure, kind="speed")
absolute = partial(Figure, kind="absolute")

SPEEDS = (
    Case(
        "decode_speed",
        "`./run bench decode`",
        (
            ratio(
                "decode_over_memcpy",
                "53 frames of 1936 x 1464 to xyz over copying them",
                target=Target(high=8),
                # Copying takes all memory channels: a busy neighbour weighs on it differently.
                factor=2.5,
            ),
            ratio(
                "decode_peak_over_stack",
                "peak memory over the stack",
                target=Target(high=1.5),
                factor=1.1,
            ),
            absolute("decode_s", "53 frames of 1936 x 1464 to xyz, s", target=Target(high=0.25)),
        ),
        reader(
            "decode",
            (),
            {
                "decode_over_memcpy": field("over_memcpy"),
                "decode_peak_over_stack": field("peak_over_stack"),
                "decode_s": field("decode_s"),
            },
        ),
    ),
    Case(
        "mechanics",
        "`./run bench mechanics`",
        (
            # A press of 50 ms is at the mercy of who shares the cache: 1.5 was seen.
            ratio(
                "mechanics_bonded_over_fft",
                "bonded 512 x 512 over an FFT pair of 1024 x 1024",
                factor=2.0,
            ),
            ratio("mechanics_free_over_fft", "free ball 512 x 512 over the same", factor=2.0),
            ratio("mechanics_slowest_over_fft", "slowest specimen over the same"),
            ratio("mechanics_study_over_fft", "25 cases over the same"),
            absolute("mechanics_bonded_s", "bonded 512 x 512, s", target=Target(high=1)),
            absolute("mechanics_free_s", "free ball 512 x 512, s", target=Target(high=2)),
            absolute("mechanics_slowest_s", "slowest specimen, s", target=Target(high=6)),
            absolute("mechanics_study_s", "25 cases, s", target=Target(high=8)),
        ),
        reader(
            "mechanics",
            ("--quick",),
            {
                "mechanics_bonded_over_fft": over("bonded_512_s", "fft_pair_s"),
                "mechanics_free_over_fft": over("free_ball_512_s", "fft_pair_s"),
                "mechanics_slowest_over_fft": over("slowest_specimen_s", "fft_pair_s"),
                "mechanics_study_over_fft": over("study_25_s", "fft_pair_s"),
                "mechanics_bonded_s": field("bonded_512_s"),
                "mechanics_free_s": field("free_ball_512_s"),
                "mechanics_slowest_s": field("slowest_specimen_s"),
                "mechanics_study_s": field("study_25_s"),
            },
        ),
    ),
    Case(
        "stack",
        "`./run bench stack`",
        (
            ratio(
                "stack_with_shadow_rays_over_one_frame",
                "54 frames, 1936 x 1464, over ONE stock Mitsuba frame, shadow rays in both",
            ),
            ratio(
                "stack_without_shadow_rays_over_one_frame",
                "the same without shadow rays in the stack: this relief is proven to cast none",
                target=Target(high=1.25),
            ),
            ratio(
                "stack_naive_over_stack",
                "54 stock frames over the whole stack, 484 x 366",
                higher_is_better=True,
            ),
            ratio(
                "stack_memory_gib",
                "memory of the full stack, GiB",
                target=Target(high=3),
                factor=1.2,
            ),
        ),
        reader(
            "stack",
            (),
            {
                "stack_with_shadow_rays_over_one_frame": field(
                    "stack_with_shadow_rays_over_one_frame"
                ),
                "stack_without_shadow_rays_over_one_frame": field(
                    "stack_without_shadow_rays_over_one_frame"
                ),
                "stack_naive_over_stack": field("naive_over_stack"),
                "stack_memory_gib": field("peak_memory_gib"),
            },
        ),
        quick=False,
    ),
    Case(
        "sweep",
        "`./run bench sweep --quick`",
        (
            ratio(
                "sweep_over_one_process",
                "48 cases by `measure` in one process over a sweep of 2 workers",
                higher_is_better=True,
                # Two workers against one process: a busy core halves only the former.
                factor=2.0,
            ),
            ratio(
                "sweep_over_one_by_one",
                "the same by `twin measure`, a process for each, over the sweep",
                target=Target(low=5),
                higher_is_better=True,
            ),
            ratio(
                "sweep_speed_up_2_workers",
                "cases that share nothing: one worker over two",
                target=Target(low=1.8),
                higher_is_better=True,
                factor=2.0,  # as above
            ),
            absolute(
                "sweep_points_per_hour", "design points per hour, 48 cases", target=Target(low=5000)
            ),
        ),
        reader(
            "sweep",
            ("--quick",),
            {
                "sweep_over_one_process": field("over_one_process"),
                "sweep_over_one_by_one": field("over_one_by_one"),
                "sweep_speed_up_2_workers": field("speed_up_2_workers"),
                "sweep_points_per_hour": field("points_per_hour"),
            },
        ),
        quick=False,
    ),
)
