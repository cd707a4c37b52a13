"""Learning in flight over real sockets: the lap with the learned model follows the course more closely."""

import json
import re
import subprocess

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import CRAZYFLIE, DOWNWASH, Sitl

# One lap: 21 s.
LAP = "family = 'figure-8'\naltitude_m = 0.8\nduration_s = 20.0\nlength_m = 1.6\nwidth_m = 0.8\nperiod_s = 4.0\nramp_s = 1.0\n"
HIDDEN = ("rotor_drag:d_xy=0.012,d_z=0.008", "thrust_curve:a=0.25")


def events(log):
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [decoded.message for *_, decoded in reader.iter_decoded_messages(topics=["/log"])]


def test_the_second_lap_uses_the_model_of_the_first(tmp_path):
    (tmp_path / "lap.toml").write_text(LAP)
    effects = [word for effect in HIDDEN for word in ("--effect", effect)]
    vehicle = Sitl(CRAZYFLIE, ["udpin:127.0.0.1:0"], effects)
    command = [*DOWNWASH, "fly", tmp_path / "lap.toml", "--connect", vehicle.peer_url(), "--vehicle", CRAZYFLIE]
    command += ["--log-dir", tmp_path, "--learn=60", "--laps", "2", "--json"]
    try:
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=150)
    finally:
        vehicle.stop()
    assert done.returncode == 0, done.stderr
    assert "panicked" not in done.stderr
    rms = [float(lap) for lap in re.findall(r"lap \d: ([0-9.]+) m RMS", done.stderr)]
    assert len(rms) == 2 and rms[1] < 0.8 * rms[0], done.stderr
    # The log has the same event, with the latency.
    logged = "\n".join(events(next(tmp_path.glob("*.mcap"))))
    assert re.search(r"lap 2 now uses the model learned in .* first setpoint [0-9.]+ s after", logged), logged
    assert json.loads(done.stdout)["end"] == "done"
