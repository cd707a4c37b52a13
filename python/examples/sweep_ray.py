"""A sweep on Ray: each task is one shard of the manifest.

    python sweep_ray.py sweep.toml sweep-out 16
"""

import sys

import downwash as dw
import ray

manifest, out, shards = sys.argv[1], sys.argv[2], int(sys.argv[3])


def fly(shard: int) -> None:
    dw.sweep(manifest, out, shard=(shard, shards), jobs=1)


ray.init(include_dashboard=False, logging_level="warning")
task = ray.remote(num_cpus=1, max_retries=3)(fly)
ray.get([task.remote(shard) for shard in range(1, shards + 1)])
# All rows are there: this writes the table, if no worker has.
print(dw.sweep(manifest, out))
