"""The tuned numbers of the search for a goal, all in one place.

Numbers that are called *fitted* come from measurements, which are named. The others are choices that did well on two
scans (35k and 50k vertices) under four maps, which ``scripts/benchmark.py accuracy`` runs, and on scenes of the tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Stage(NamedTuple):
    """What a search is content with, stricter stages first.

    Attributes
    ----------
    target : float
        Transport is explored until some combination is expected to have at most this part of the wanted error.
    sufficient : float
        Expensive trials are skipped if some combination is expected to have at most this part of it; zero for none.
    margin : float
        Standard errors, from measuring some vertices only, that are kept free.
    """

    target: float
    sufficient: float
    margin: float


@dataclass(frozen=True)
class SearchTuning:
    """Attributes are described beside their values."""

    # --- What may be chosen ------------------------------------------------------------------------------------------

    # Rays per receiver and bandlimits, unless they are given.
    samples: tuple[int, ...] = tuple(1 << e for e in range(6, 15))
    bandlimits: tuple[int, ...] = (*range(1, 11), 12, 15, 20, 25, 30, 35, 40, 45, 50)

    # Tables of what the triangles of a direction set integrate to: bytes for each direction and harmonic (48 rows of
    # float32 for each of two triangles per direction), and the most that are held.
    table_bytes: float = 384.0
    largest_tables: float = 1.5e9

    # --- Vertices and references -------------------------------------------------------------------------------------

    # Vertices that are chosen by, and as many held out. More for errors up to `small_error`, which few vertices make
    # most of, and which take long anyway.
    pilot_vertices: int = 3072
    large_pilot_vertices: int = 4096
    small_error: float = 0.03
    # Fewer vertices than these are not worth another verification.
    fewest_held_out: int = 256

    # Relative noise of references under maps: this part of the wanted error, or without one this.
    noise_share: float = 0.35
    usual_noise: float = 0.015

    # Reference under light of a spectrum: rays and bandlimit for spectra of maps, bandlimit for light that falls as
    # 1/(l+1).
    spectrum_samples: int = 1024
    spectrum_bandlimit: int = 30
    falling_bandlimit: int = 20
    # Rays that tell which vertices are inside other geometry.
    interior_samples: int = 256

    # --- Cost of transport -------------------------------------------------------------------------------------------

    # Microseconds of a receiver with s rays in n directions and M harmonics, α s + β M + γ n M, and of the tables of a
    # direction set, δ n M. Fitted on two scans and two cores. Only their ratios matter: measured times scale them.
    ray_cost: float = 0.083
    harmonic_cost: float = 0.024
    projection_cost: float = 3.4e-5
    table_cost: float = 3.1
    # The same of compression, per receiver and harmonic, for tolerances about as fine as transport. Fitted on the same.
    coding_cost: float = 0.29
    # A machine that is slower than that at rays is at most so many times slower at compression.
    slowest_coding: float = 3.0
    # Vertices from all over a mesh share less of the tracer's caches than neighbours do: seconds of neighbours over
    # theirs, fitted on the same.
    scattered: float = 0.88
    # Vertices that are traced before the clock starts, so that kernels are compiled.
    warm_up: int = 64

    # --- Exploring transport -----------------------------------------------------------------------------------------

    # Bandlimits that are explored, one after the other.
    explored_bandlimits: tuple[int, ...] = (10, 20, 30, 50)
    # Squared errors of few rays fall with this power of their number: between 1.3 and 1.7 on scans.
    noise_exponent: float = 1.5
    # A trial is expensive if it takes more than this part of a run that is expected to be sufficient.
    expensive: float = 0.12

    # --- Compression on trial ----------------------------------------------------------------------------------------

    # Caps that are coded, and neighbouring vertices of each at most: caps differ more from each other than within.
    tried_caps: int = 24
    vertices_of_cap: int = 250
    # Transport of other rays, which coding errors are compared with, reaches 2 L + `beyond_bandlimit`, this degree at
    # most.
    beyond_bandlimit: int = 4
    highest_beyond: int = 30
    # Tolerance of the bases before any is known.
    first_tolerance: float = 0.05
    finest_tolerance: float = 1e-5
    coarsest_tolerance: float = 0.9
    # The tolerance over the error that is left for it, to begin with: it bounds the error under light of the prior, and
    # what it adds to that of transport is less.
    usual_tolerance: float = 1.35
    # Tolerances that are tried at most. One that is off by no more than `close_tolerance` is corrected untried, by a
    # power law, with this part of the room used.
    tolerance_trials: int = 4
    close_tolerance: float = 1.35
    room_used: float = 0.98
    # Bounds of the exponent of that law, and of a step between two trials.
    tolerance_exponents: tuple[float, float] = (0.5, 3.0)
    tolerance_steps: tuple[float, float] = (0.1, 3.0)
    # Coding errors cancel a part of transport's; at least this part of their square is counted as added.
    least_added: float = 0.1
    # Seconds of all caps over those of the sample: projection (the sample is scattered), and coding, which takes less
    # than one pass with a choice of axes until the step is right, since small parts of caps take longer.
    projection_passes: float = 0.5
    coding_passes: float = 0.8

    # --- A wanted error ----------------------------------------------------------------------------------------------

    # Parts of the error that transport alone may have: one candidate is coded for each, as long as what the last one
    # took to measure is at most `worth_trying` of what the best one takes.
    shares: tuple[float, ...] = (0.75, 0.6, 0.9, 0.96)
    worth_trying: float = 0.2
    # A candidate whose transport takes at least this part of all that the best one takes cannot be better.
    hopeless: float = 0.9
    # Candidates that are traced for each share, if none of them leaves room for compression.
    attempts: int = 4
    # Of the wanted error, compression gets at least this part.
    least_for_coding: float = 0.2
    # Expensive trials are skipped if there is something sufficient, unless that turns out to fail; and if nothing is
    # safe, what is likely is better than nothing.
    stages: tuple[Stage, ...] = (Stage(0.75, 0.9, 2.0), Stage(0.9, 0.0, 2.0), Stage(0.96, 0.0, 0.4))
    # Of the wanted error, this part is kept free for what models miss; with standard errors at most `most_free`.
    models_off: float = 0.03
    most_free: float = 0.2
    # What is offered if nothing meets the error leaves this part of it to compression and chance.
    offered: float = 0.95

    # --- A wanted time -----------------------------------------------------------------------------------------------

    # Of the time, this part is kept free.
    time_free: float = 0.12
    # Of what is left, transport may take: for combinations that are explored, and for those that are chosen.
    time_to_explore: float = 0.2
    time_for_run: float = 0.55
    # No more candidates once this part of the time is over, or after so many.
    time_for_trials: float = 0.7
    timed_candidates: int = 4
    # Of combinations whose error is at most so much worse than the best, the fastest; after one that took too long,
    # only what takes this part of it.
    hardly_worse: float = 1.1
    speed_up: float = 0.4
    # Squared error that compression may always add.
    least_allowance: float = 1e-6

    # --- Run and verification ----------------------------------------------------------------------------------------

    # Coded again with a finer tolerance at most so often, if the vertices that were chosen by have too much error; the
    # tolerance is a little finer still, and falls by at most so much in squares.
    reviews: int = 2
    review_finer: float = 0.98
    review_fall: float = 0.1
    # If the vertices held out have more error than was wanted, all is done again so often, with an aim that is lower by
    # what was missed and by this factor.
    repeats: int = 1
    aimed_lower: float = 0.95
    # Coefficients up to this number are kept as they will be decoded, so that verification need not decode them.
    kept_decoded: int = 50_000_000


TUNING = SearchTuning()
