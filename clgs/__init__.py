"""Vendor-neutral Gaussian splatting: training, compression and rendering on OpenCL."""

from __future__ import annotations

__version__ = "0.1.0"
