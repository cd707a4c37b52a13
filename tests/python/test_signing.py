"""MAVLink 2 signing: key files, signed flights, and attacks with independently built frames."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import CRAZYFLIE, DOWNWASH, QUICK, Sitl, fly_arguments, free_port
from signing_conformance import ATTACKS, attack, stamp_now

SUITE = Path(__file__).with_name("signing_conformance.py")


def run(*arguments, settings=QUICK):
    command = [*DOWNWASH, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, env=os.environ | settings)


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "key"
    made = run("signing", "key", path)
    assert made.returncode == 0, made.stderr
    return path


@pytest.fixture
def config(tmp_path, key_file):
    path = tmp_path / "signed.toml"
    path.write_text(f"[link.signing]\nkey_file = '{key_file}'\n")
    return path


def key_of(path):
    return bytes.fromhex(path.read_text().strip())


def test_a_key_file_is_private_and_never_printed(hover, tmp_path, key_file, config):
    assert key_file.stat().st_mode & 0o777 == 0o600
    assert len(key_of(key_file)) == 32
    secret = key_file.read_text().strip()
    assert run("signing", "key", key_file).returncode == 2, "an existing key is not overwritten"
    shown = run("config", "--config", config, "--json")
    assert shown.returncode == 0 and secret not in shown.stdout + shown.stderr
    key_file.chmod(0o644)
    refused = run(*fly_arguments(hover, "udpin:127.0.0.1:0", tmp_path, "--config", config))
    assert refused.returncode == 2
    assert "0600" in refused.stderr and secret not in refused.stderr


def test_a_signed_flight_leaves_no_key_in_its_log(hover, tmp_path, key_file, config, quick_landing):
    sitl = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"], ["--signing-key", str(key_file), *quick_landing])
    arguments = fly_arguments(hover, sitl.peer_url(), tmp_path)
    try:
        # Without the key downwash can send only unsigned frames, and the vehicle obeys none.
        waits = {"DOWNWASH_LINK__SEARCH_TIMEOUT_S": "4.0", "DOWNWASH_OFFBOARD__SUPERVISOR__READY_TIMEOUT_S": "6.0"}
        blind = run(*arguments, settings=waits)
        assert blind.returncode != 0 and "sign" in blind.stderr
        checked = run(*arguments, "--config", config, "--check")
        assert checked.returncode == 0, checked.stderr
        # The stamps continue where they ended.
        state = json.loads((tmp_path / "key.stamps").read_text())
        flown = run(*arguments, "--config", config)
        assert flown.returncode == 0, flown.stderr
        later = json.loads((tmp_path / "key.stamps").read_text())
        assert later["newest"] > state["newest"] > stamp_now() - 10**8
        assert [row["system"] for row in later["streams"]] == [1] * len(later["streams"]) != []
    finally:
        sitl.stop()
    secret = key_of(key_file)
    for log in tmp_path.glob("*.mcap"):
        assert secret not in log.read_bytes() and secret.hex().encode() not in log.read_bytes()


@pytest.mark.parametrize("right", [True, False], ids=["same-key", "other-key"])
def test_a_pymavlink_vehicle_needs_the_same_key(hover, hand_made, tmp_path, key_file, config, right):
    vehicle, url = hand_made
    key = key_of(key_file) if right else bytes(range(32))
    vehicle.link.setup_signing(key, sign_outgoing=True, allow_unsigned_callback=None,
                               initial_timestamp=stamp_now(), link_id=3)
    search = {"DOWNWASH_LINK__SEARCH_TIMEOUT_S": "4.0"}
    flown = run(*fly_arguments(hover, url, tmp_path, "--config", config), settings=QUICK | search)
    if right:
        assert flown.returncode == 0, flown.stderr
        assert vehicle.setpoints and vehicle.highest > 0.6
        assert vehicle.link.mav.signing.badsig_count == 0
    else:
        assert flown.returncode == 3, flown.stderr
        assert "wrong signature" in flown.stderr
        assert not vehicle.setpoints and not vehicle.armed


def test_setup_installs_changes_and_removes_a_key(hover, tmp_path, key_file, config):
    sitl = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"])
    try:
        url = sitl.peer_url()
        given = run("signing", "setup", "--connect", url, "--config", config)
        assert given.returncode == 0, given.stderr
        assert "signs with the key" in given.stdout and key_file.read_text().strip() not in given.stdout
        new = tmp_path / "new"
        assert run("signing", "key", new).returncode == 0
        changed = tmp_path / "changed.toml"
        changed.write_text(f"[link.signing]\nkey_file = '{new}'\n")
        # Without the current key nobody can set another one.
        stranger = run("signing", "setup", "--connect", url, "--config", changed)
        assert stranger.returncode == 3, stranger.stdout
        own = run("signing", "setup", "--connect", url, "--config", changed, "--old-key", key_file)
        assert own.returncode == 0, own.stderr
        taken = run("signing", "setup", "--connect", url, "--config", changed, "--off")
        assert taken.returncode == 0, taken.stderr
        assert run(*fly_arguments(hover, url, tmp_path, "--check")).returncode == 0
    finally:
        sitl.stop()


def test_vehicle_init_reads_a_vehicle_that_obeys_only_signed_frames(tmp_path, key_file, config):
    options = ["--autopilot", "px4", "--signing-key", str(key_file)]
    sitl = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"], options)
    try:
        url, out = sitl.peer_url(), tmp_path / "quad.toml"
        made = run("vehicle", "init", "--connect", url, "--config", config, "-o", out, "--json")
    finally:
        sitl.stop()
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["autopilot"] == "PX4"
    assert out.exists()
    # Its stamps are stored, and the vehicle's stream.
    stamps = json.loads((tmp_path / "key.stamps").read_text())
    assert stamps["newest"] > 0 and {row["system"] for row in stamps["streams"]} == {1}
    secret = key_file.read_text().strip()
    assert secret not in made.stdout + made.stderr + out.read_text()


def expected_results():
    return [(name, right, right) for name, right, _ in ATTACKS]


def test_the_bundled_vehicle_refuses_every_attack(key_file):
    sitl = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"], ["--signing-key", str(key_file)])
    try:
        assert attack(sitl.peer_url(), key_of(key_file), "station") == expected_results()
    finally:
        sitl.stop()


def test_downwash_refuses_every_attack(program, key_file, config):
    port = free_port()
    program("inspect", "--connect", f"udpin:127.0.0.1:{port}", "--config", config, "--seconds", 60)
    assert attack(f"udpout:127.0.0.1:{port}", key_of(key_file), "vehicle") == expected_results()


def test_attacks_that_pymavlink_accepts_match_the_docs(key_file):
    port = free_port()
    responder = subprocess.Popen([sys.executable, str(SUITE), f"udpin:127.0.0.1:{port}", "--key", str(key_file),
                                  "--respond"], stdout=subprocess.PIPE, text=True)
    try:
        assert responder.stdout.readline().strip() == "ready"
        results = attack(f"udpout:127.0.0.1:{port}", key_of(key_file), "station")
    finally:
        responder.kill()
        responder.wait()
    wrong = {name for name, right, was in results if was != right}
    assert wrong == {
        "true frame after a forged stamp an hour ahead",
        "a stamp five years ahead",
        "a new link id after that, stamp of now",
    }
