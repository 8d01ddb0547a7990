"""The parts of ``scripts/reproduce.py``: a table of runs, trained as tasks, and their report."""
