//! The faults' changes to the vehicle's messages.

use wire::dialect::*;

use super::script::{Fault, Timed};
use super::{frame_content, signing};

/// A clock offset this close to the 32-bit wrap of milliseconds, us.
const BEFORE_WRAP_US: i64 = 4_294_967_296_000 - 12_000_000;

/// Rewrites the vehicle's messages according to the acting faults.
#[derive(Debug, Default)]
pub(super) struct Tamper {
    frozen: Option<[Option<MavMessage>; 4]>,
}

impl Tamper {
    /// The frame as the link carries it at `now_us`.
    pub fn apply(&mut self, faults: &[Timed], now_us: u64, frame: &[u8]) -> Vec<u8> {
        let acting = || faults.iter().filter(|it| it.acts(now_us) || lasts(it, now_us));
        let offset_us: i64 = acting().map(|timed| clock_offset_us(&timed.fault)).sum();
        let is_frozen = acting().any(|timed| timed.fault == Fault::Freeze);
        if !is_frozen {
            self.frozen = None;
        }
        let is_changed =
            acting().any(|timed| changes_state(&timed.fault)) && frame_content::is_state(frame);
        let is_stamped = offset_us != 0 && !frame_content::is_mode(frame);
        if !(is_changed || is_stamped) {
            return frame.to_vec();
        }
        let Some(mut message) = frame_content::message(frame) else { return frame.to_vec() };
        if is_frozen {
            self.freeze(&mut message);
        }
        for timed in acting() {
            spoil(&timed.fault, &mut message);
        }
        let old_s: f64 = acting().map(|timed| old_by_s(&timed.fault)).sum();
        let old_us = if frame_content::is_state(frame) { (old_s * 1e6) as i64 } else { 0 };
        stamp(&mut message, offset_us, offset_us - old_us);
        frame_content::in_place_of(frame, &message, &signing::key())
    }

    /// Replaces a state by an earlier one, under the new stamp.
    fn freeze(&mut self, message: &mut MavMessage) {
        let slot = match message {
            MavMessage::ODOMETRY(_) => 0,
            MavMessage::LOCAL_POSITION_NED(_) => 1,
            MavMessage::ATTITUDE_QUATERNION(_) => 2,
            MavMessage::ATTITUDE(_) => 3,
            _ => return,
        };
        let held = self.frozen.get_or_insert_default()[slot].get_or_insert_with(|| message.clone());
        let mut old = held.clone();
        match (&mut old, &*message) {
            (MavMessage::ODOMETRY(old), MavMessage::ODOMETRY(new)) => old.time_usec = new.time_usec,
            (MavMessage::LOCAL_POSITION_NED(old), MavMessage::LOCAL_POSITION_NED(new)) => {
                old.time_boot_ms = new.time_boot_ms;
            }
            (MavMessage::ATTITUDE_QUATERNION(old), MavMessage::ATTITUDE_QUATERNION(new)) => {
                old.time_boot_ms = new.time_boot_ms;
            }
            (MavMessage::ATTITUDE(old), MavMessage::ATTITUDE(new)) => {
                old.time_boot_ms = new.time_boot_ms;
            }
            _ => {}
        }
        *message = old;
    }
}

/// A clock close to its wrap is so from the start; a stepped clock stays off, like a reset
/// estimate.
fn lasts(timed: &Timed, now_us: u64) -> bool {
    match timed.fault {
        Fault::ClockWrap => !timed.acts(now_us),
        Fault::ClockStep { .. } | Fault::Jump { is_told: true, .. } => now_us >= timed.end_us(),
        _ => false,
    }
}

fn clock_offset_us(fault: &Fault) -> i64 {
    match fault {
        Fault::ClockStep { by_s } => (by_s * 1e6) as i64,
        Fault::ClockWrap => BEFORE_WRAP_US,
        _ => 0,
    }
}

fn old_by_s(fault: &Fault) -> f64 {
    if let Fault::OldStamps { by_s } = fault { *by_s } else { 0.0 }
}

fn changes_state(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::Freeze
            | Fault::Jump { .. }
            | Fault::NotANumber
            | Fault::OldStamps { .. }
            | Fault::OtherFrame
    )
}

fn spoil(fault: &Fault, message: &mut MavMessage) {
    match (fault, message) {
        (Fault::Jump { metres, is_told }, MavMessage::ODOMETRY(data)) => {
            data.x += *metres as f32;
            data.y += 0.5 * *metres as f32;
            data.reset_counter = data.reset_counter.wrapping_add((*is_told).into());
        }
        (Fault::Jump { metres, .. }, MavMessage::LOCAL_POSITION_NED(data)) => {
            data.x += *metres as f32;
            data.y += 0.5 * *metres as f32;
        }
        (Fault::NotANumber, MavMessage::ODOMETRY(data)) => data.vx = f32::NAN,
        (Fault::NotANumber, MavMessage::LOCAL_POSITION_NED(data)) => data.vx = f32::NAN,
        (Fault::NotANumber, MavMessage::ATTITUDE_QUATERNION(data)) => data.q2 = f32::NAN,
        (Fault::NotANumber, MavMessage::ATTITUDE(data)) => data.roll = f32::NAN,
        (Fault::OtherFrame, MavMessage::ODOMETRY(data)) => {
            data.frame_id = MavFrame::MAV_FRAME_LOCAL_ENU;
        }
        _ => {}
    }
}

/// Moves the stamps of samples by `sample_us`, and the clock's own reports by `clock_us`.
fn stamp(message: &mut MavMessage, clock_us: i64, sample_us: i64) {
    let ms = |stamp: u32| stamp.wrapping_add((sample_us / 1000) as u32);
    let us = |stamp: u64| stamp.saturating_add_signed(sample_us);
    match message {
        MavMessage::ODOMETRY(data) => data.time_usec = us(data.time_usec),
        MavMessage::HIGHRES_IMU(data) => data.time_usec = us(data.time_usec),
        MavMessage::LOCAL_POSITION_NED(data) => data.time_boot_ms = ms(data.time_boot_ms),
        MavMessage::ATTITUDE_QUATERNION(data) => data.time_boot_ms = ms(data.time_boot_ms),
        MavMessage::ATTITUDE(data) => data.time_boot_ms = ms(data.time_boot_ms),
        MavMessage::ATTITUDE_TARGET(data) => data.time_boot_ms = ms(data.time_boot_ms),
        MavMessage::ACTUATOR_OUTPUT_STATUS(data) => data.time_usec = us(data.time_usec),
        MavMessage::SERVO_OUTPUT_RAW(data) => {
            data.time_usec = data.time_usec.wrapping_add(sample_us as u32);
        }
        MavMessage::TIMESYNC(data) if data.tc1 != 0 => data.tc1 += clock_us * 1000,
        _ => {}
    }
}
