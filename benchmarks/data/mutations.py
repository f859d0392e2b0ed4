"""Seeded damage to the bytes of a file: bit flips, truncations, swapped blocks and more."""

from collections.abc import Callable

import numpy as np

Mutation = Callable[[bytes, np.random.Generator], bytes]


def _flip_bits(data: bytes, rng: np.random.Generator, count: int) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(0, len(data), count):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _block(data: bytes, rng: np.random.Generator) -> slice:
    """Return where a block of 1 byte to a quarter of the file lies."""
    size = int(rng.integers(1, max(2, len(data) // 4)))
    start = int(rng.integers(0, len(data) - size + 1))
    return slice(start, start + size)


def _truncated(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(1, len(data)))]


def _swapped(data: bytes, rng: np.random.Generator) -> bytes:
    size = int(rng.integers(1, max(2, len(data) // 4)))
    first = int(rng.integers(0, len(data) - 2 * size + 1))
    second = int(rng.integers(first + size, len(data) - size + 1))
    blocks = data[first : first + size], data[second : second + size]
    return data[:first] + blocks[1] + data[first + size : second] + blocks[0] + data[second + size :]


def _zeroed(data: bytes, rng: np.random.Generator) -> bytes:
    block = _block(data, rng)
    return data[: block.start] + bytes(block.stop - block.start) + data[block.stop :]


def _repeated(data: bytes, rng: np.random.Generator) -> bytes:
    block = _block(data, rng)
    return data[: block.stop] + data[block] + data[block.stop :]


def _cut_out(data: bytes, rng: np.random.Generator) -> bytes:
    block = _block(data, rng)
    return data[: block.start] + data[block.stop :]


def _foreign_text(data: bytes, rng: np.random.Generator) -> bytes:
    return f"a file of another version {rng.integers(10**9)}\n".encode()


MUTATIONS: dict[str, Mutation] = {
    "one bit flipped": lambda data, rng: _flip_bits(data, rng, 1),
    "bits flipped": lambda data, rng: _flip_bits(data, rng, int(rng.integers(2, 64))),
    "truncated": _truncated,
    "blocks swapped": _swapped,
    "bytes appended": lambda data, rng: data + rng.bytes(int(rng.integers(1, 4096))),
    "block of zeros": _zeroed,
    "block repeated": _repeated,
    "block cut out": _cut_out,
    "of another version": _foreign_text,
    "empty": lambda data, rng: b"",
}
# An empty file is always the same one; every other mutation is drawn anew.
_DRAWN = [name for name in MUTATIONS if name != "empty"]


def mutated(data: bytes, number: int, seed: int) -> tuple[str, bytes]:
    """Return the name and the result of one mutation: the first is the empty file, the others go round."""
    rng = np.random.default_rng([seed, number])
    if number == 0:
        return "empty", b""
    name = _DRAWN[number % len(_DRAWN)]
    while (changed := MUTATIONS[name](data, rng)) == data:
        pass  # zeros over zeros, or two equal blocks
    return name, changed
