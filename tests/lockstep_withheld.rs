//! A setpoint is the answer to the newest sample, for the vehicle that it was made for, while the
//! supervisor permits it: what else a read brings, nothing leaves.

mod lockstep;

use std::cell::Cell;
use std::rc::Rc;

use downwash::supervisor::FlightState;
use lockstep::{Bench, NANO, message_id};
use sitl::autopilot::{COMPONENT_ID, Mode, SYSTEM_ID};
use wire::dialect::*;
use wire::Encoder;

const HEARTBEAT: u32 = 0;
const ODOMETRY: u32 = 331;
const CURRENT_MODE: u32 = 436;

fn in_track(mut bench: Bench) -> Bench {
    bench.until(FlightState::Track, 30.0);
    bench.run(2.0);
    bench
}

/// A frame of the vehicle that it did not send.
fn forged(message: &MavMessage) -> Vec<u8> {
    let mut bytes = Vec::new();
    assert!(Encoder::new(SYSTEM_ID, COMPONENT_ID).encode(message, &mut bytes));
    bytes
}

fn heartbeat(mode: Mode) -> Vec<u8> {
    forged(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: mode.custom_mode(),
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    }))
}

/// The first sample from now on comes in one read with a word of the mode behind it, and other
/// words of it are lost. Gives when that was.
fn read_with_mode(bench: &mut Bench, mode: Mode) -> Rc<Cell<Option<u64>>> {
    let taken_us = Rc::new(Cell::new(None));
    let taken = Rc::clone(&taken_us);
    let heartbeat = heartbeat(mode);
    bench.downlink = Box::new(move |now_us, frame| match message_id(frame) {
        Some(ODOMETRY) if taken.get().is_none() => {
            taken.set(Some(now_us));
            vec![[frame, heartbeat.as_slice()].concat()]
        }
        Some(HEARTBEAT | CURRENT_MODE) => vec![],
        _ => vec![frame.to_vec()],
    });
    taken_us
}

/// The sample comes first in a datagram, and what ends control behind it.
#[test]
fn a_sample_is_not_answered_where_the_same_read_ends_control() {
    let mut bench = in_track(Bench::hovering(NANO, 30.0));
    let taken_us = read_with_mode(&mut bench, Mode::Position);
    bench.run(0.2);
    let taken_us = taken_us.get().expect("a sample");
    assert_eq!(bench.phase(), Some(FlightState::PilotControl), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(taken_us - 1), 0);
}

#[test]
fn a_sample_is_not_answered_where_the_same_read_hands_over_to_the_landing() {
    let mut bench = Bench::hovering(NANO, 1.0);
    // The vehicle never hears that it is to land, and control goes on for its while.
    bench.until(FlightState::Hold, 30.0);
    bench.run(1.9);
    bench.uplink = false;
    bench.until(FlightState::Land, 1.0);
    let asked_us = bench.now_us();
    bench.run(0.1);
    assert!(bench.setpoints_after(asked_us) > 5, "streams until the vehicle has taken over");
    let taken_us = read_with_mode(&mut bench, Mode::Land);
    bench.run(0.2);
    let taken_us = taken_us.get().expect("a sample");
    assert_eq!(bench.phase(), Some(FlightState::Land), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(taken_us - 1), 0);
}
