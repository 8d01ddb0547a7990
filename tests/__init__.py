"""Tests of clgs; ``tests.compare`` and ``tests/conftest.py`` serve them all."""

import os

# Before NumPy is imported, here and in processes of tests: its second thread waits by running, and
# takes the time of the device and of other tests.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
