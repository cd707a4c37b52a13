"""The table of the plants: best figure of all rounds, and its ratio to a peer's."""

import json
import sys

best: dict[tuple, dict] = {}
with open(sys.argv[1], encoding="utf-8") as file:
    for line in file:
        row = json.loads(line)
        key = (row["tool"], row.get("instructions", ""), row["precision"], row["what"], row["vehicles"])
        if key not in best or best[key]["steps_per_s"] < row["steps_per_s"]:
            best[key] = row

peers = {}
for tool in ("crazyflow", "rotorpy"):
    rates = [row["steps_per_s"] for key, row in best.items() if key[0] == tool]
    if rates:
        peers[tool] = max(rates)
heads = "".join(f"{f'times {tool}':>18}" for tool in peers)
print(f"{'tool':11}{'instructions':14}{'':5}{'what':48}{'vehicles':>9}{'million steps/s':>17}{heads}")
for (tool, instructions, precision, what, vehicles), row in best.items():
    rate = row["steps_per_s"]
    ratios = "".join(f"{rate / peer:18.1f}" for peer in peers.values())
    print(f"{tool:11}{instructions:14}{precision:5}{what:48}{vehicles:9}{rate / 1e6:17.4f}{ratios}")
print("times a peer: over the best figure of that peer, whatever its integrator and number of vehicles")
