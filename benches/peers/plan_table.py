"""The medians of all rounds as one table: `python plan_table.py RESULTS`, one JSON object per line."""

import json
import statistics
import sys

runs = {}
with open(sys.argv[1]) as lines:
    for line in lines:
        run = json.loads(line)
        runs.setdefault((run["model"], run["periods"], run["start"], run["tool"]), []).append(run)

print("| model | N | start | tool | ms | least | times ours | cost | defect | subproblems | iterations |")
print("|---|---|---|---|---|---|---|---|---|---|---|")
median = {key: statistics.median(run["seconds"] for run in results) for key, results in runs.items()}
for (model, periods, start, tool), results in sorted(runs.items()):
    key, run = (model, periods, start, tool), results[0]
    ours = median.get((model, periods, start, "downwash"))
    ratio = f"{median[key] / ours:.1f}" if ours else "-"
    least = min(run["least_s"] for run in results)
    print(
        f"| {model} | {periods} | {start} | {tool} | {1e3 * median[key]:.1f} | {1e3 * least:.1f} | {ratio} "
        f"| {run['cost']:.5f} | {run['defect']:.1e} | {run['subproblems'] or '-'} | {run['iterations']} |"
    )
