"""Learning in flight over real sockets: the lap with the learned model follows the course more closely."""

import json
import re

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import fly_arguments, only_log

# One lap: 17 s, of which learning may take ten on a busy machine.
LAP = "family = 'figure-8'\naltitude_m = 0.8\nduration_s = 16.0\nlength_m = 1.6\nwidth_m = 0.8\nperiod_s = 4.0\nramp_s = 1.0\n"
HIDDEN = ("rotor_drag:d_xy=0.012,d_z=0.008", "thrust_curve:a=0.25")


def events(log):
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [decoded.message for *_, decoded in reader.iter_decoded_messages(topics=["/log"])]


def test_the_second_lap_uses_the_model_of_the_first(program, crazyflie, tmp_path):
    (tmp_path / "lap.toml").write_text(LAP)
    url = crazyflie(effects=HIDDEN).peer_url()
    options = ("--learn=60", "--laps", 2, "--json")
    flight = program(*fly_arguments(tmp_path / "lap.toml", url, tmp_path, *options))
    code, out = flight.finish(150)
    assert code == 0, flight.err
    assert "panicked" not in flight.err
    rms = [float(lap) for lap in re.findall(r"lap \d: ([0-9.]+) m RMS", flight.err)]
    assert len(rms) == 2 and rms[1] < 0.8 * rms[0], flight.err
    # The log has the same event, with the latency.
    logged = "\n".join(events(only_log(tmp_path)))
    assert re.search(r"lap 2 now uses the model learned in .* first setpoint [0-9.]+ s after", logged), logged
    assert json.loads(out)["end"] == "done"
