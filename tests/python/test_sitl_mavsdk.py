"""MAVSDK-Python as a client of the vehicle: connect, arm, take off, fly in OFFBOARD, land."""

import pytest

mavsdk = pytest.importorskip("mavsdk")

from conftest import HOVER, until  # noqa: E402
from mavsdk import ComponentType, Configuration, Mavsdk  # noqa: E402
from mavsdk.plugins.action.action import Action, ActionError  # noqa: E402
from mavsdk.plugins.offboard.offboard import Attitude, Offboard, OffboardError  # noqa: E402
from mavsdk.plugins.telemetry.telemetry import Telemetry  # noqa: E402


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
    until(telemetry.health_all_ok, "health")

    with pytest.raises(OffboardError):
        offboard.start()  # no setpoint set

    action.set_takeoff_altitude(1.5)
    action.arm()
    until(telemetry.armed, "armed")
    action.takeoff()
    until(lambda: telemetry.position().relative_altitude_m > 1.3, "height")
    until(lambda: telemetry.flight_mode().name == "HOLD", "hold")
    with pytest.raises(ActionError):
        action.disarm()

    offboard.set_attitude(Attitude(6.0, 0.0, 0.0, HOVER))
    offboard.start()
    until(lambda: telemetry.flight_mode().name == "OFFBOARD", "offboard")
    until(lambda: abs(telemetry.attitude_euler().roll_deg - 6.0) < 1.0, "roll")
    offboard.set_attitude(Attitude(0.0, 0.0, 0.0, HOVER))
    until(lambda: abs(telemetry.attitude_euler().roll_deg) < 1.0, "level")
    offboard.stop()
    until(lambda: telemetry.flight_mode().name == "HOLD", "hold again")

    action.land()
    until(lambda: not telemetry.armed(), "disarmed", timeout=30)
    until(lambda: telemetry.landed_state().name == "ON_GROUND", "landed")
