"""Tests of clgs; ``tests.compare`` and ``tests/conftest.py`` serve them all."""
