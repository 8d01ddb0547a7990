"""Runs as tasks on dask.distributed: on this machine, or wherever a scheduler has workers."""
