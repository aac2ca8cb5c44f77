"""Doing the same for many items: in this process, in several on this machine, or on a Dask cluster.

    with open_workers() as workers:
        for index, result in workers.map_unordered(function, items, shared=dataset):
            ...

Where the work is done does not change what comes out. A worker that is lost costs only time: what it was at is done
again. Leaving the `with` block, for whatever reason, leaves no process of ours behind.
"""

from pipeline.parallel.workers import HERE, Here, Workers, open_workers

__all__ = ["HERE", "Here", "Workers", "open_workers"]
