"""The settings of which `clgs bench accuracy` measures time and error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from clgs.errors import UsageError
from clgs.options import PRESETS, Accuracy

PRESET_SWEEP = "preset"
FINE = Accuracy("", alpha_cut=2.0**-16, transmittance_stop=1e-6, inclusive_stop=True)
"""Around which sweeps turn one knob: its error must not drown in those of the others."""

CUTS = (255, 512, 1024, 4096, 16384, 65536)
STOPS = (("1e-6", 1e-6), ("1e-4", 1e-4), ("1e-3", 1e-3), ("1/512", 1 / 512), ("1/255", 1 / 255))
DEGREES = (3, 4, 5, 6)
EXTENTS = (0.0, 1.0, 2.0, 3.0)


@dataclass(frozen=True)
class Setting:
    """One point of the plot: the sweep that it belongs to, its name there, what is truncated."""

    sweep: str
    label: str
    accuracy: Accuracy


def accuracy_settings(sweeps: Sequence[str] = ()) -> list[Setting]:
    """List every preset, and sweeps of one knob, with the others as in FINE.

    Args:
        sweeps: names of the sweeps to list, in addition to the presets; empty: all.

    Raises:
        UsageError: there is no such sweep.
    """
    settings = [Setting(PRESET_SWEEP, name, accuracy) for name, accuracy in PRESETS.items()]

    def add(sweep: str, label: str, **knobs: float | bool) -> None:
        settings.append(Setting(sweep, label, replace(FINE, **knobs)))  # type: ignore[arg-type]

    for share in CUTS:
        add("alpha cut", f"1/{share}", alpha_cut=1 / share)
    for inclusive in (False, True):
        for label, stop in STOPS:
            sweep = f"{'inclusive' if inclusive else 'exclusive'} stop"
            add(sweep, label, transmittance_stop=stop, inclusive_stop=inclusive)
    for degree in DEGREES:
        add("exp2 degree", str(degree), exp2_degree=degree)
    for extent in EXTENTS:
        add("least extent", f"{extent:g} px", min_extent=extent)
    add("resolution", "full", downscale=1)
    add("resolution", "1/2", downscale=2)
    names = list(dict.fromkeys(one.sweep for one in settings))
    for sweep in sweeps:
        if sweep not in names:
            raise UsageError(f"no sweep {sweep!r}; there are {', '.join(names)}")
    return [one for one in settings if not sweeps or one.sweep in (PRESET_SWEEP, *sweeps)]


def without_stop(accuracy: Accuracy) -> Accuracy:
    """The same alpha cut, no stop, the exponential of float32: what stop and degree do differs."""
    return replace(
        accuracy, name="", transmittance_stop=1e-9, inclusive_stop=True, exp2_degree=max(DEGREES)
    )
