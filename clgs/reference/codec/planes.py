"""Words as planes of bytes, for reading (FORMAT.md on MLPS); same bytes as C."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from clgs.reference.codec.coding import (
    WEIGHT_ONE,
    Coder,
    RangeDecoder,
    RangeEncoder,
    State,
    code_mixed,
)

LIMIT, SHIFT = 250, 14


def encode(weights: npt.NDArray[np.float32]) -> bytes:
    """The plane stream of ``weights`` (n,) float32."""
    words = [int(word) for word in weights.view(np.uint32)]
    raw = b"\0" + np.asarray(weights, "<f4").tobytes()
    coder = RangeEncoder()
    _code_words(coder, len(words), words)
    coded = b"\1" + coder.finish()
    return coded if words and len(coded) <= len(raw) else raw


def decode(data: bytes, count: int) -> npt.NDArray[np.float32]:
    """``count`` weights (count,) float32.

    Raises:
        ValueError: the stream is damaged.
    """
    if data[0] == 0:
        return np.frombuffer(data, "<f4", count, offset=1)
    coder = RangeDecoder(data[1:])
    words = _code_words(coder, count, None)
    coder.finish()
    return np.array(words, np.uint32).view(np.float32)


def _code_words(coder: Coder, count: int, words: list[int] | None) -> list[int]:
    """Code words byte by byte from the top; contexts: plane, and top byte or exponent."""
    plain: dict[tuple[int, ...], State] = defaultdict(lambda: State(LIMIT))
    joint: dict[tuple[int, ...], State] = defaultdict(lambda: State(LIMIT))
    weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: [WEIGHT_ONE // 2] * 2)
    done: list[int] = []
    for i in range(count):
        word, context = 0, done[-1] >> 24 if done else 0
        for plane in range(4):
            byte, node = (words[i] >> (24 - 8 * plane) & 255 if words else 0), 1
            for place in range(7, -1, -1):
                states = [plain[plane, node], joint[plane, context, node]]
                bit = byte >> place & 1
                node = node << 1 | code_mixed(coder, bit, states, weights[plane, node], SHIFT)
            word = word << 8 | (node & 255)
            context = word if plane == 0 else word >> 7 & 255 if plane == 1 else context
        done.append(word)
    return done
