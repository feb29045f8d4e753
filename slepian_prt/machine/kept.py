"""What was made of an object, kept as long as the object is, and made once however many threads ask for it."""

from __future__ import annotations

import os
from collections.abc import Callable
from threading import Lock, RLock
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary, WeakSet

Key = TypeVar("Key")
Value = TypeVar("Value")

_all: WeakSet[Kept] = WeakSet()


class Kept(Generic[Key, Value]):
    """Values by the objects that they were made from, which are hashable and can be referenced weakly."""

    def __init__(self) -> None:
        self._values: WeakKeyDictionary[Key, Value] = WeakKeyDictionary()
        self.make_locks()
        _all.add(self)

    def make_locks(self) -> None:
        """At first, and in a forked process: those that other threads held then are never released there."""
        self._lock = Lock()
        self._making: WeakKeyDictionary[Key, RLock] = WeakKeyDictionary()

    def of(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of an object, made now if it is not there; another thread that asks for it meanwhile waits."""
        with self._lock:
            if key in self._values:
                return self._values[key]
            making = self._making.setdefault(key, RLock())
        with making:
            with self._lock:
                if key in self._values:
                    return self._values[key]
            value = make()
            self.put(key, value)
            return value

    def get(self, key: Key) -> Value | None:
        """The value if it is there."""
        with self._lock:
            return self._values.get(key)

    def put(self, key: Key, value: Value) -> None:
        """Keep a value that is known already."""
        with self._lock:
            self._values[key] = value

    def forget(self, key: Key) -> None:
        """Free the memory of a value, once nobody uses it."""
        with self._lock:
            self._values.pop(key, None)


def _after_fork() -> None:
    for kept in list(_all):
        kept.make_locks()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
