"""A sweep on Dask: each task is one shard of the manifest.

    python sweep_dask.py sweep.toml sweep-out 16
"""

import sys

import downwash as dw
from dask.distributed import Client

manifest, out, shards = sys.argv[1], sys.argv[2], int(sys.argv[3])


def fly(shard: int) -> None:
    dw.sweep(manifest, out, shard=(shard, shards), jobs=1)


if __name__ == "__main__":
    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        client.gather(client.map(fly, range(1, shards + 1)))
    print(dw.sweep(manifest, out))
