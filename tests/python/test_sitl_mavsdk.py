"""MAVSDK-Python as a client of the vehicle: connect, arm, take off, fly in OFFBOARD, land."""

import time

import pytest

mavsdk = pytest.importorskip("mavsdk")

from mavsdk import ComponentType, Configuration, Mavsdk  # noqa: E402
from mavsdk.plugins.action.action import Action, ActionError  # noqa: E402
from mavsdk.plugins.offboard.offboard import Attitude, Offboard, OffboardError  # noqa: E402
from mavsdk.plugins.telemetry.telemetry import Telemetry  # noqa: E402

HOVER_THRUST = 0.4905


def until(what, condition, timeout=20.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"{what}: not within {timeout} s"
        time.sleep(0.02)


@pytest.fixture
def drone(sitl, request):
    scheme, target = request.param
    vehicle = sitl(f"{scheme}:127.0.0.1:0", speed=2)
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    sdk.add_any_connection(f"{target}://127.0.0.1:{vehicle.port()}")
    system = sdk.first_autopilot(10.0)
    assert system is not None, "MAVSDK finds the vehicle"
    yield system
    sdk.destroy()


@pytest.mark.parametrize("drone", [("udpin", "udpout"), ("tcpin", "tcpout")], indirect=True)
def test_a_mavsdk_flight(drone):
    action, telemetry, offboard = Action(drone), Telemetry(drone), Offboard(drone)
    until("health", telemetry.health_all_ok)

    with pytest.raises(OffboardError):
        offboard.start()  # no setpoint set

    action.set_takeoff_altitude(1.5)
    action.arm()
    until("armed", telemetry.armed)
    action.takeoff()
    until("height", lambda: telemetry.position().relative_altitude_m > 1.3)
    until("hold", lambda: telemetry.flight_mode().name == "HOLD")
    with pytest.raises(ActionError):
        action.disarm()

    offboard.set_attitude(Attitude(6.0, 0.0, 0.0, HOVER_THRUST))
    offboard.start()
    until("offboard", lambda: telemetry.flight_mode().name == "OFFBOARD")
    until("roll", lambda: abs(telemetry.attitude_euler().roll_deg - 6.0) < 1.0)
    offboard.set_attitude(Attitude(0.0, 0.0, 0.0, HOVER_THRUST))
    until("level", lambda: abs(telemetry.attitude_euler().roll_deg) < 1.0)
    offboard.stop()
    until("hold again", lambda: telemetry.flight_mode().name == "HOLD")

    action.land()
    until("disarmed", lambda: not telemetry.armed(), timeout=30)
    until("landed", lambda: telemetry.landed_state().name == "ON_GROUND")
