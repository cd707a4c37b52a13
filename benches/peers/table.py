"""The medians of all rounds as one table: `python table.py RESULTS`, one JSON object per line."""

import json
import statistics
import sys

REFERENCE = "downwash rprop"

runs = {}
with open(sys.argv[1]) as lines:
    for line in lines:
        run = json.loads(line)
        runs.setdefault((run["tool"], run["threads"]), []).append(run)

per_100 = {}
for key, results in runs.items():
    per_100[key] = {
        field: statistics.median(100 * run[field] / run["passes"] for run in results)
        for field in ("seconds", "cpu_s")
    }

print("| tool | threads | s / 100 passes | CPU s | times ours | passes | train MSE | test MSE | MiB |")
print("|---|---|---|---|---|---|---|---|---|")
for (tool, threads), results in sorted(runs.items(), key=lambda item: (item[0][1], item[0][0])):
    time, run = per_100[tool, threads], results[0]
    ratio = time["seconds"] / per_100[REFERENCE, threads]["seconds"]
    error = lambda part: " / ".join(f"{net[part]:.5f}" for net in run["errors"])
    print(
        f"| {tool} | {threads} | {time['seconds']:.2f} | {time['cpu_s']:.2f} | {ratio:.1f} "
        f"| {run['passes']} | {error('training')} | {error('test')} | {run['peak_mib']:.0f} |"
    )
