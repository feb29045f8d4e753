import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slepian_prt.compression.codec.lanes import LaneReader, LaneWords, ModelTable, Symbols, encode_lanes
from slepian_prt.compression.codec.models import WHOLE, frequencies
from tests.numerics import assert_exact

TABLE = ModelTable(frequencies())


def drawn(rng, counts) -> Symbols:
    """Symbols as their models foretell them."""
    total = int(np.sum(counts))
    models = rng.integers(0, len(TABLE.frequencies) - 1, total)
    slots = rng.integers(0, WHOLE, total)
    symbols = (slots[:, None] >= np.cumsum(TABLE.frequencies[models], axis=1)).sum(axis=1)
    return Symbols(np.asarray(counts, dtype=np.int64), models, symbols)


def read_one_by_one(cap: LaneWords, calls, c: int) -> list[list[int]]:
    """The same in plain integers, as the format tells it."""
    ends = np.cumsum(cap.lengths.astype(int))
    words = [list(map(int, part)) for part in np.split(cap.words, ends[:-1])]
    states = [part.pop(0) << 16 | part.pop(0) for part in words]
    found = []
    for call in calls:
        begin = int(call.counts[:c].sum())
        found.append([])
        for i, model in enumerate(call.models[begin : begin + int(call.counts[c])]):
            lane = i % len(states)
            slot = states[lane] % WHOLE
            sizes = TABLE.frequencies[model].tolist()
            symbol = next(s for s in range(len(sizes)) if slot < sum(sizes[: s + 1]))
            size, first = sizes[symbol], sum(sizes[:symbol])
            states[lane] = states[lane] // WHOLE * size + slot - first
            if states[lane] < 1 << 16:
                states[lane] = states[lane] << 16 | words[lane].pop(0)
            found[-1].append(symbol)
    assert all(state == 1 << 16 for state in states)
    assert not any(words)
    return found


@given(
    st.lists(st.lists(st.integers(0, 60), min_size=3, max_size=3), min_size=1, max_size=5),
    st.lists(st.integers(1, 70), min_size=3, max_size=3),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_symbols_come_back_and_are_those_of_the_format(counts, lanes, seed):
    """More lanes than symbols, lanes without any, caps without any."""
    rng = np.random.default_rng(seed)
    calls = [drawn(rng, row) for row in counts]
    caps = encode_lanes(calls, np.array(lanes), TABLE)
    reader = LaneReader(caps, TABLE)
    for call in calls:
        assert_exact(reader.read(call.counts, call.models), call.symbols, because="integers")
    reader.check_end()
    for c, cap in enumerate(caps):
        expected = [np.split(call.symbols, np.cumsum(call.counts)[:-1])[c].tolist() for call in calls]
        assert read_one_by_one(cap, calls, c) == expected


def test_a_cap_without_symbols_has_no_lanes(rng):
    calls = [drawn(rng, [0, 30, 0])]
    caps = encode_lanes(calls, np.array([0, 2, 0]), TABLE)
    assert [cap.words.size for cap in (caps[0], caps[2])] == [0, 0]
    reader = LaneReader(caps, TABLE)
    assert_exact(reader.read(calls[0].counts, calls[0].models), calls[0].symbols, because="integers")
    reader.check_end()
    with pytest.raises(ValueError, match="no lanes"):
        encode_lanes(calls, np.array([1, 0, 1]), TABLE)


def test_size_is_the_entropy_and_four_bytes_a_lane(rng):
    call = drawn(rng, [40_000])
    bits = -np.log2(TABLE.frequencies[call.models, call.symbols] / WHOLE).sum()
    for lanes in (1, 40):
        words = encode_lanes([call], np.array([lanes]), TABLE)[0].words
        # Of a state's 32 bits, half is where it begins; whole words round up by up to one more.
        assert bits - 32 <= 16 * words.size <= 1.001 * bits + 32 * lanes


def test_cut_words_are_found_at_the_end(rng):
    call = drawn(rng, [500, 500])
    caps = encode_lanes([call], np.array([3, 4]), TABLE)
    with pytest.raises(ValueError, match="number of words"):
        LaneReader([caps[0], LaneWords(caps[1].lengths, caps[1].words[:-1])], TABLE)
    for place in range(0, caps[0].words.size, 7):
        words = caps[0].words.copy()
        words[place] ^= 64
        reader = LaneReader([LaneWords(caps[0].lengths, words), caps[1]], TABLE)
        reader.read(call.counts, call.models)
        with pytest.raises(ValueError, match="end"):
            reader.check_end()
