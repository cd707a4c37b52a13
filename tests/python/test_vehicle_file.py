"""Vehicle files made from a vehicle's parameters, checked, and found by name from any folder."""

import json
import subprocess
import tomllib

import pytest

from conftest import CRAZYFLIE, DOWNWASH, SHORT_HOVER, free_port
from hand_made_vehicle import HandMadeVehicle
from vehicle_variants import VehicleVariant

# The parameters of PX4's SIH quadrotor; whole numbers travel as byte-cast integers.
SIH = {
    "SYS_AUTOSTART": 10040,
    "MAV_TYPE": 2,
    "CA_AIRFRAME": 0,
    "CA_ROTOR_COUNT": 4,
    **{f"PWM_MAIN_FUNC{n}": 100 + n for n in range(1, 5)},
    **{f"PWM_MAIN_FUNC{n}": 0 for n in range(5, 9)},
    "MC_ROLL_P": 4.0,
    "MC_PITCH_P": 4.0,
    "MC_YAW_P": 2.8,
    "IMU_GYRO_CUTOFF": 40.0,
    "IMU_DGYRO_CUTOFF": 20.0,
    "IMU_GYRO_RATEMAX": 800,
    "THR_MDL_FAC": 0.0,
    "MPC_THR_HOVER": 0.5,
    "BAT1_N_CELLS": 4,
    "BAT1_V_CHARGED": 4.05,
    "SIH_MASS": 1.0,
    "SIH_IXX": 0.025,
    "SIH_IYY": 0.025,
    "SIH_IZZ": 0.03,
    "SIH_T_MAX": 5.0,
    "SIH_Q_MAX": 0.1,
    "SIH_L_ROLL": 0.2,
    "SIH_L_PITCH": 0.2,
    "SIH_T_TAU": 0.05,
    "SIH_KDV": 1.0,
    "SIH_KDW": 0.025,
    "SIH_VEHICLE_TYPE": 0,
}
for rotor, (x, y, km) in enumerate([(1.0, 1.0, 0.05), (-1.0, -1.0, 0.05), (1.0, -1.0, -0.05), (-1.0, 1.0, -0.05)]):
    SIH |= {f"CA_ROTOR{rotor}_PX": x, f"CA_ROTOR{rotor}_PY": y, f"CA_ROTOR{rotor}_KM": km}
for axis, p, i, d, most in [
    ("ROLL", 0.15, 0.2, 0.003, 220.0),
    ("PITCH", 0.15, 0.2, 0.003, 220.0),
    ("YAW", 0.2, 0.1, 0.0, 200.0),
]:
    name = f"MC_{axis}RATE"
    SIH |= {f"{name}_P": p, f"{name}_I": i, f"{name}_D": d, f"{name}_FF": 0.0, f"{name}_K": 1.0, f"{name}_MAX": most}
SIH |= {"MC_RR_INT_LIM": 0.3, "MC_PR_INT_LIM": 0.3, "MC_YR_INT_LIM": 0.3}


def downwash(folder, *arguments, timeout=60):
    command = [*DOWNWASH, *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout)
    assert "panicked" not in done.stderr
    return done


@pytest.fixture
def px4(tmp_path):
    """A hand-made vehicle with PX4's parameters; yields its link and cleans up."""
    port = free_port()
    vehicle = HandMadeVehicle(f"udpout:127.0.0.1:{port}")
    vehicle.params = dict(SIH)
    yield vehicle, f"udpin:127.0.0.1:{port}"
    vehicle.stop()


def test_init_makes_a_file_from_the_connected_vehicle(px4, tmp_path):
    vehicle, url = px4
    before = dict(vehicle.params)
    done = downwash(tmp_path, "vehicle", "init", "--connect", url, "-o", "quad.toml", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["schema"], summary["autopilot"], summary["missing"]) == ("downwash.vehicle.init", "PX4", [])
    # It set no parameter, requested no stream and armed nothing.
    assert vehicle.params == before
    assert {command for command, _, _ in vehicle.commands} <= {512}
    file = tomllib.loads((tmp_path / "quad.toml").read_text())
    assert file["mass"] == 1.0 and file["battery"]["cells"] == 4
    loop = file["attitude_cascade"]
    # MC_ROLLRATE_P times the mixer's 2 sqrt(2) N m, MC_YAWRATE_P times 0.4 N m.
    assert loop["rate_p_Nms"] == pytest.approx([0.42426, 0.42426, 0.08], rel=1e-4)
    assert loop["angle_p_per_s"] == [4.0, 4.0, 2.8]
    assert file["provenance"]["mass"]["from"] == "SIH_MASS"

    assert downwash(tmp_path, "vehicle", "check", "quad.toml").returncode == 0
    # The file suffices for a plan without edits.
    done = downwash(tmp_path, "plan", "hover", "--vehicle", "quad.toml", "--out", "plan.json", timeout=120)
    assert done.returncode == 0, done.stderr
    # An existing file is not overwritten.
    done = downwash(tmp_path, "vehicle", "init", "--connect", url, "-o", "quad.toml")
    assert done.returncode == 2 and "--force" in done.stderr


def test_init_names_two_connected_vehicles_and_makes_no_file(tmp_path):
    port = free_port()
    vehicles = [VehicleVariant(f"udpout:127.0.0.1:{port}", system=system) for system in (1, 2)]
    try:
        done = downwash(tmp_path, "vehicle", "init", "--connect", f"udpin:127.0.0.1:{port}", "-o", "quad.toml")
    finally:
        for vehicle in vehicles:
            vehicle.stop()
    assert done.returncode == 4, done.stderr
    assert "--system 1" in done.stderr and "--system 2" in done.stderr
    assert not (tmp_path / "quad.toml").exists()


def test_init_reports_a_silent_link_within_seconds(tmp_path):
    command = [*DOWNWASH, "vehicle", "init", "--connect", f"udpin:127.0.0.1:{free_port()}"]
    waiting = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = waiting.stderr.readline()
        assert "waiting for the HEARTBEAT" in line and "0 bytes" in line
    finally:
        waiting.terminate()
    waiting.communicate(timeout=10)
    assert waiting.returncode == 130


def test_init_reads_a_parameter_file(tmp_path):
    rows = [f"1\t1\t{name}\t{value:.18f}\t{6 if isinstance(value, int) else 9}" for name, value in SIH.items()]
    (tmp_path / "my.params").write_text("# Onboard parameters for Vehicle 1\n" + "\n".join(rows) + "\n")
    done = downwash(tmp_path, "vehicle", "init", "my.params", "--mass", "1.2", "--name", "mine", "--inertia", "0.02,0.02,0.03")
    assert done.returncode == 0, done.stderr
    file = tomllib.loads(done.stdout)
    assert (file["name"], file["mass"]) == ("mine", 1.2)
    assert file["inertia"] == [0.02, 0.02, 0.03]
    assert file["hover_thrust"] == pytest.approx(1.2 * 9.80665 / 20, rel=1e-4)


def test_init_names_each_missing_value_and_its_option(tmp_path):
    done = downwash(tmp_path, "vehicle", "init", "--arm", "0.22", "-o", "quad.toml")
    assert done.returncode == 0
    assert "missing: mass" in done.stderr and "--mass" in done.stderr
    done = downwash(tmp_path, "vehicle", "check", "quad.toml")
    assert done.returncode == 2 and "no key mass" in done.stderr


def test_a_file_without_parameters_is_refused_by_name(tmp_path):
    done = downwash(tmp_path, "vehicle", "init", CRAZYFLIE)
    assert done.returncode == 2
    assert "crazyflie.toml" in done.stderr and "parameter file" in done.stderr


def test_a_mass_in_grams_is_refused(tmp_path):
    text = CRAZYFLIE.read_text().replace("mass = 0.030", "mass = 30.0")
    (tmp_path / "grams.toml").write_text(text)
    (tmp_path / "hover.toml").write_text(SHORT_HOVER)
    done = downwash(tmp_path, "vehicle", "check", "grams.toml", "--json")
    assert done.returncode == 10
    remark = json.loads(done.stdout)["remarks"][0]
    assert (remark["field"], remark["doubt"]) == ("mass", "cannot_fly")
    for arguments in (["plan", "hover.toml"], ["fly", "hover.toml", "--connect", "udpout:127.0.0.1:9"]):
        done = downwash(tmp_path, *arguments, "--vehicle", "grams.toml")
        assert done.returncode == 2, done.stderr
        assert "looks like grams" in done.stderr and "1.3 to 12 times" in done.stderr
    huge = text.replace("mass = 30.0", "mass = 1e300")
    (tmp_path / "huge.toml").write_text(huge)
    done = downwash(tmp_path, "vehicle", "check", "huge.toml")
    assert done.returncode == 2 and "at most 1e6" in done.stderr


def test_shipped_files_are_found_by_name(tmp_path):
    listed = json.loads(downwash(tmp_path, "vehicle", "list", "--json").stdout)
    vehicles = [vehicle["name"] for vehicle in listed["vehicles"]]
    assert "crazyflie" in vehicles and "figure-8" in [entry["name"] for entry in listed["trajectories"]]
    for vehicle in vehicles:
        assert downwash(tmp_path, "vehicle", "check", vehicle).returncode == 0
    done = downwash(tmp_path, "plan", "figure-9", "--vehicle", "crazyflie")
    assert done.returncode == 2 and "figure-8" in done.stderr
    done = downwash(tmp_path, "plan", "hover", "--vehicle", "crazyfly")
    assert done.returncode == 2 and "crazyflie, quad1200" in done.stderr


def test_check_compares_a_file_with_a_flight(tmp_path):
    done = downwash(tmp_path, "collect", "--out", "flights", "--seconds", "40", "--vehicle", "crazyflie", timeout=300)
    assert done.returncode == 0, done.stderr
    (flight,) = (tmp_path / "flights").glob("*unstructured*.mcap")
    done = downwash(tmp_path, "vehicle", "check", "crazyflie", "--log", str(flight), "--json")
    assert done.returncode == 0, done.stdout
    verdicts = {held["check"]: held["verdict"] for held in json.loads(done.stdout)["held"]}
    # The flight keeps one heading.
    assert verdicts == {"hover": "fits", "outputs": "fits", "roll": "fits", "pitch": "fits", "yaw": "not_shown"}

    text = CRAZYFLIE.read_text().replace("mass = 0.030", "mass = 0.045")
    (tmp_path / "heavy.toml").write_text(text)
    done = downwash(tmp_path, "vehicle", "check", "heavy.toml", "--log", str(flight))
    assert done.returncode == 10
    assert "differs: hover: by the outputs the rotors' vertical thrust is 0.294 N" in done.stdout
    assert "expected 0.441 N for 0.0450 kg" in done.stdout
