//! The judge on reports and setpoints at given times, as on sockets.

use super::*;
use crate::campaign::draw;
use crate::campaign::script::Script;
use wire::Encoder;

const OBEYS: u32 = 6 << 16;
const POSITION: u32 = 3 << 16;

/// A judge, with encoders for the vehicle and the station.
struct Court {
    judge: Judge,
    vehicle: Encoder,
    station: Encoder,
}

impl Court {
    fn new(in_transit_s: f64) -> Self {
        let bounds = Bounds {
            thrust: [0.0, 1.0],
            tilt_rad: 1.0,
            body_rate_rad_s: 5.0,
            thrust_change_per_s: 100.0,
            body_rate_change_rad_s2: 1000.0,
            obeys: OBEYS,
            lands: 4 << 16 | 6 << 24,
        };
        let script = Script { policy: EngagePolicy::Command, ..draw::script(1, 1) };
        let judge = Judge::new(&script, bounds, &[[0.0; 3]]).patient(in_transit_s);
        Self { judge, vehicle: Encoder::new(1, 1), station: Encoder::new(254, 191) }
    }

    fn encoded(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.vehicle.encode(message, &mut bytes);
        bytes
    }

    fn receive(&mut self, ms: u64, message: &MavMessage) {
        let bytes = self.encoded(message);
        let now_us = ms * 1000;
        let passing =
            Passing { arrival_us: now_us, sent_us: now_us, origin: Origin::Vehicle, bytes };
        self.judge.station_received(now_us, &passing);
    }

    fn mode(&mut self, ms: u64, custom_mode: u32) {
        let base_mode = MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED;
        let data = HEARTBEAT_DATA { custom_mode, base_mode, ..Default::default() };
        self.receive(ms, &MavMessage::HEARTBEAT(data));
    }

    fn state(&mut self, ms: u64) {
        self.receive(ms, &MavMessage::ODOMETRY(ODOMETRY_DATA::default()));
    }

    fn setpoint(&mut self, ms: u64) {
        let data = SET_ATTITUDE_TARGET_DATA {
            q: [1.0, 0.0, 0.0, 0.0],
            thrust: 0.5,
            target_system: 1,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        self.station.encode(&MavMessage::SET_ATTITUDE_TARGET(data), &mut bytes);
        self.judge.station_sent(ms * 1000, &bytes);
    }

    fn rules(&self) -> Vec<Rule> {
        self.judge.violations().iter().map(|violation| violation.rule).collect()
    }
}

/// A normal flight until 1000 ms.
fn in_flight(in_transit_s: f64) -> Court {
    let mut court = Court::new(in_transit_s);
    court.mode(990, OBEYS);
    court.state(1000);
    court.setpoint(1000);
    assert_eq!(court.rules(), []);
    court
}

#[test]
fn lockstep_answer_must_leave_at_the_instant_of_its_state() {
    let mut court = in_flight(0.0);
    court.state(1010);
    court.setpoint(1011);
    assert_eq!(court.rules(), [Rule::Fresh]);
}

#[test]
fn socket_answer_may_be_in_transit_but_only_once_per_state() {
    let mut court = in_flight(IN_TRANSIT_S);
    court.state(1010);
    court.state(1020);
    court.setpoint(1022);
    court.setpoint(1023);
    assert_eq!(court.rules(), []);
    court.setpoint(1024);
    assert_eq!(court.rules(), [Rule::Fresh], "a third answer to two states");
    let mut court = in_flight(IN_TRANSIT_S);
    court.state(1010);
    court.setpoint(1075);
    assert_eq!(court.rules(), [Rule::Fresh], "65 ms are not a transit time");
}

#[test]
fn late_duplicate_state_is_not_the_one_answered() {
    let mut court = in_flight(IN_TRANSIT_S);
    court.state(1010);
    let copy = Passing {
        arrival_us: 1_011_000,
        sent_us: 20_000,
        origin: Origin::Copy,
        bytes: court.encoded(&MavMessage::ODOMETRY(ODOMETRY_DATA::default())),
    };
    court.judge.station_received(1_011_000, &copy);
    court.setpoint(1012);
    assert_eq!(court.rules(), []);
    court.judge.station_received(1_100_000, &Passing { arrival_us: 1_100_000, ..copy });
    court.setpoint(1101);
    assert_eq!(court.rules(), [Rule::Fresh], "the copy alone is too old to answer");
}

#[test]
fn setpoint_crossing_the_pilots_mode_change_is_no_violation() {
    let mut court = in_flight(IN_TRANSIT_S);
    court.mode(1005, POSITION);
    court.state(1010);
    court.setpoint(1012);
    assert_eq!(court.rules(), [], "it was in transit");
    court.state(1070);
    court.setpoint(1071);
    assert_eq!(court.rules(), [Rule::AgainstThePilot]);
    let mut court = in_flight(0.0);
    court.mode(1010, POSITION);
    court.state(1010);
    court.setpoint(1010);
    assert_eq!(court.rules(), [Rule::AgainstThePilot], "in lockstep it was already read");
}

#[test]
fn no_answer_is_allowed_while_the_backlog_is_read() {
    for (ms, rules) in [(1205, &[Rule::Stalled][..]), (1215, &[])] {
        let mut court = in_flight(IN_TRANSIT_S);
        court.judge.woke(1_200_000);
        court.state(ms - 1);
        court.setpoint(ms);
        assert_eq!(court.rules(), rules, "{ms}");
    }
}
