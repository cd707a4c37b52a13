"""The programs in real time keep their code in memory, so that a machine short of memory does not delay them."""

import resource
import sys
from pathlib import Path

import pytest

from conftest import fly_arguments

CAP_IPC_LOCK = 14


def status(pid, key):
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(line.split()[1] for line in lines if line.startswith(key + ":"))


def may_lock():
    is_capable = int(status("self", "CapEff"), 16) >> CAP_IPC_LOCK & 1
    return is_capable or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has /proc")
def test_programs_in_real_time_lock_their_code(program, crazyflie, hover, tmp_path):
    vehicle = crazyflie()
    flight = program(*fly_arguments(hover, vehicle.peer_url(), tmp_path))
    flight.says("preflight checks passed")
    for process in (vehicle.process, flight.process):
        locked_kb = int(status(process.pid, "VmLck"))
        # Without the permission they run all the same.
        assert locked_kb > 1024 if may_lock() else locked_kb == 0
    code, _ = flight.finish()
    assert code == 0, flight.err
