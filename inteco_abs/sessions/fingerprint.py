"""A fingerprint of this computer's floating-point functions, which the metadata record `software` has.

Where a replay differs, it shows whether the computer that recorded the session computes other last bits.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import struct
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final

from inteco_abs import elementary

LIBM_SHA256: Final = "arithmetic.libm_sha256"
"""Key of the hash of results of the C library."""
PORTABLE_SHA256: Final = "arithmetic.portable_sha256"
"""Key of the hash of results of `elementary`, the same on every computer."""
_POINTS: Final = 1000
_GOLDEN_RATIO: Final = 0x9E3779B97F4A7C15
"""Its fraction, with 64 bits: multiples are spread evenly."""
_OF_ANY: Final = (math.exp, math.expm1, math.sin, math.cos, math.tan, math.atan, math.sinh, math.tanh)
_OF_POSITIVE: Final = (math.log, math.log2, math.log10, math.log1p)
"""Of the C library, as those before; `math.hypot`, `sum` and others are Python's own."""
_FEATURES: Final = frozenset(("sse2", "avx", "avx2", "avx512f", "fma", "fma4", "asimd", "sve", "sve2", "neon", "vfpv4"))
"""Features of processors by which C libraries choose their functions, as Linux names them."""


@cache
def arithmetic_facts() -> dict[str, str]:
    """The C library, hashes of results of its functions and of `elementary`, and features of the processor, if known.

    Takes 10 ms the first time.
    """
    facts = {
        "libc": " ".join(platform.libc_ver()).strip(),
        "arithmetic": elementary.PORTABLE,
        LIBM_SHA256: _sha256(_libm_results()),
        PORTABLE_SHA256: _sha256(_portable_results()),
        "arithmetic.cpu_features": _cpu_features(),
        "arithmetic.glibc_tunables": os.environ.get("GLIBC_TUNABLES", ""),
    }
    return {name: value for name, value in facts.items() if value}


def other_arithmetic(software: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """What differs here from the `software` that recorded a session, by name: as `recorded`, and `here`.

    Empty where the same functions have the same results, and for a session without a fingerprint.
    """
    here = arithmetic_facts()
    if all(software.get(name, here[name]) == here[name] for name in (LIBM_SHA256, PORTABLE_SHA256)):
        return {}
    names = [name for name in {**software, **here} if name == "libc" or name.startswith("arithmetic.")]
    pairs = {name: {"recorded": software.get(name, ""), "here": here.get(name, "")} for name in names}
    return {name: pair for name, pair in pairs.items() if pair["recorded"] != pair["here"]}


def describe_other_arithmetic(found: Mapping[str, Mapping[str, str]]) -> str:
    """Text of what `other_arithmetic` has found, which is not nothing."""
    facts = [
        f"{name.rpartition('.')[2]} {pair['here'] or 'none'}, was {pair['recorded'] or 'none'}"
        for name, pair in found.items()
        if not name.endswith("_sha256")
    ]
    whose = "the project's own functions compute" if PORTABLE_SHA256 in found else "the C library computes"
    return f"{whose} other bits than where it was recorded: {'; '.join(facts) or 'another processor or build'}"


def _spread() -> Iterator[float]:
    """Numbers in 0..1, exact."""
    return ((n * _GOLDEN_RATIO % (1 << 64) >> 11) * 2.0**-53 for n in range(1, _POINTS + 1))


def _libm_results() -> Iterator[float]:
    for u in _spread():
        x, positive = 100.0 * (u - 0.5), 4.0 * u
        yield from (function(x) for function in _OF_ANY)
        yield from (function(positive) for function in _OF_POSITIVE)
        yield math.pow(u, x)
        yield math.atan2(x, positive)


def _portable_results() -> Iterator[float]:
    own = elementary.ARITHMETICS[elementary.PORTABLE]  # as the module may have the C library's now
    for n, u in enumerate(_spread()):
        yield own["exp"](1454.0 * u - 745.0)
        yield own["log"](math.ldexp(1.0 + u, 2 * n - _POINTS))
        yield own["power"](u, n / 100.0 - 5.0)
        yield own["sin"](100.0 * u)
        yield from own["sin_cos"](2e4 * u - 1e4)


def _sha256(results: Iterable[float]) -> str:
    found = list(results)
    return hashlib.sha256(struct.pack(f"<{len(found)}d", *found)).hexdigest()


def _cpu_features() -> str:
    """Features of the first processor, of those that matter; empty where Linux does not list them."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    found = {name.strip(): value for name, _, value in (line.partition(":") for line in reversed(lines))}
    return " ".join(sorted(_FEATURES.intersection(found.get("flags", found.get("Features", "")).split())))
