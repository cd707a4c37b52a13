"""A sweep with submitit, on Slurm or, as here, on this machine: each job is one shard.

    python sweep_submitit.py sweep.toml sweep-out 4
"""

import sys

import downwash as dw
import submitit

manifest, out, shards = sys.argv[1], sys.argv[2], int(sys.argv[3])


def fly(shard: int) -> None:
    dw.sweep(manifest, out, shard=(shard, shards), jobs=1)


if __name__ == "__main__":
    executor = submitit.AutoExecutor(folder=f"{out}/jobs", cluster="local")
    executor.update_parameters(timeout_min=60)
    for job in executor.map_array(fly, list(range(1, shards + 1))):
        job.result()
    print(dw.sweep(manifest, out))
