"""Lines of text and the numbers in them, read fast and refused exactly."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True, eq=False)
class Lines:
    """Where the lines of a text are.

    Attributes
    ----------
    text : bytes
        With a line feed after each line, as long as the file up to there.
    starts, ends : (N,) int64
        Each line with its line feed is ``text[start:end]``.
    words : (N,) int64
        Numbers of words in them.
    begins : (N,) int64
        Where their first words begin; their line feeds if they have none.
    """

    text: bytes
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    words: NDArray[np.int64]
    begins: NDArray[np.int64]

    def read(self, line: int) -> bytes:
        """The words of a line, without white space around them."""
        return self.text[self.begins[line] : self.ends[line]].strip()

    def find_bad_number(
        self,
        chosen: NDArray[np.int64],
        begin: int = 0,
        dtype: DTypeLike = np.float64,
        edit: Callable[[bytes], bytes] = bytes,
    ) -> tuple[int, str] | None:
        """The first line of some that has a word which is no number, and the word.

        Parameters
        ----------
        chosen : (K,)
            Lines.
        begin : int
            Where the numbers begin in each.
        edit : function
            Leaves only numbers and what is bad.
        """
        words = [edit(self.read(line)[begin:]).split() for line in chosen.tolist()]
        flat = [word for row in words for word in row]
        bad = find_bad_number(flat, dtype)
        if bad is None:
            return None
        row = np.searchsorted(np.cumsum([len(row) for row in words]), bad, side="right")
        return int(chosen[row]), flat[bad].decode("latin-1")[:40]

    def select(self, chosen: NDArray[np.bool_]) -> bytes:
        """The text of some lines."""
        turns = np.flatnonzero(np.diff(chosen.astype(np.int8), prepend=0, append=0))
        begins, ends = self.starts[turns[0::2]].tolist(), self.ends[turns[1::2] - 1].tolist()
        return b"".join([self.text[begin:end] for begin, end in zip(begins, ends, strict=True)])

    def characters(self, offset: int) -> NDArray[np.uint8]:
        """(N,) the characters so far behind the beginnings of the first words; line feeds beyond the end."""
        data = np.frombuffer(self.text, dtype=np.uint8)
        return data[np.minimum(self.begins + offset, len(data) - 1)]


def split_lines(raw: bytes) -> Lines:
    """Find lines that end in LF, CR LF or CR; a mark of the byte order is blank."""
    text = raw.replace(b"\r\n", b" \n").replace(b"\r", b"\n") if b"\r" in raw else raw
    if text.startswith(b"\xef\xbb\xbf"):
        text = b"   " + text[3:]
    if not text.endswith(b"\n"):
        text += b"\n"
    data = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(data == 10) + 1
    starts = np.concatenate([[0], ends[:-1]])
    begun = data > 32
    begun[1:] &= data[:-1] <= 32
    places = np.flatnonzero(begun)
    first = np.searchsorted(places, starts)  # a tenth of the time of np.add.reduceat
    words = np.diff(first, append=len(places))
    begins = ends - 1
    filled = words > 0
    begins[filled] = places[first[filled]]
    return Lines(text, starts, ends, words, begins)


def parse_numbers(text: bytes, count: int, dtype: DTypeLike = np.float64) -> NDArray[Any] | None:
    """Numbers between white space, or None if anything else is there, or not so many.

    `np.fromstring` takes two thirds of the time of `np.array(text.split(), dtype)`, a fourth for integers.
    """
    if not text.strip():
        return np.empty(0, dtype=dtype) if count == 0 else None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # until NumPy 2.3 what is no number is a warning
        try:
            numbers = np.fromstring(text, dtype=dtype, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
    return numbers if len(numbers) == count else None  # "1-2" and "1.2.3" are two numbers to it


def find_bad_number(words: Sequence[bytes], dtype: DTypeLike = np.float64) -> int | None:
    """Index of the first word that `parse_numbers` does not read, by bisection; None if it reads all."""
    begin, end = 0, len(words)
    if parse_numbers(b" ".join(words), end, dtype) is not None:
        return None
    while end - begin > 1:
        middle = (begin + end) // 2
        if parse_numbers(b" ".join(words[begin:middle]), middle - begin, dtype) is None:
            end = middle
        else:
            begin = middle
    return begin
