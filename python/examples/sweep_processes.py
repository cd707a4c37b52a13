"""A sweep with local processes, started as a scheduler would start them.

    python sweep_processes.py sweep.toml sweep-out 4
"""

import multiprocessing
import sys

import downwash as dw

manifest, out, shards = sys.argv[1], sys.argv[2], int(sys.argv[3])


def fly(shard: int) -> None:
    dw.sweep(manifest, out, shard=(shard, shards), jobs=1)


if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(fly, range(1, shards + 1), chunksize=1)
    print(dw.sweep(manifest, out))
