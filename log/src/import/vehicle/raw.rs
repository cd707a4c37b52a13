//! What only the importer reads of a vehicle's messages, and not the link.

use mavlink::MessageData;
use vehicle::frame::Frd;
use wire::dialect::*;
use wire::{Frame, message_name};

use super::VehicleLog;
use crate::import::STANDARD_GRAVITY;
use crate::import::clocks::FrameTime;
use crate::import::epoch::{ImuSample, Source};

/// Servo outputs that wait at most for another message with the vehicle's time; a log may have none.
const OUTPUTS_WAITING_MAX: usize = 200;

/// Whether the codec does not decode this message, or decodes less of it than the importer needs.
pub(super) fn is_raw(id: u32) -> bool {
    matches!(
        id,
        ESC_STATUS_DATA::ID
            | RAW_IMU_DATA::ID
            | SCALED_IMU_DATA::ID
            | SCALED_IMU2_DATA::ID
            | SCALED_IMU3_DATA::ID
            | SERVO_OUTPUT_RAW_DATA::ID
            | SYS_STATUS_DATA::ID
    )
}

/// What is new in a HIGHRES_IMU, and of which sensor.
pub(super) struct Updates {
    /// Number of the sensor, from 0.
    pub sensor: u8,
    /// Whether the accelerometer's sample is new.
    pub force: bool,
    /// Whether the gyro's sample is new.
    pub rate: bool,
}

impl Updates {
    /// By `fields_updated` and `id`. If all flags are unset, the sender does not fill them in.
    pub fn of_highres_imu(payload: &[u8]) -> Self {
        /// Offset after the time and thirteen floats.
        const FIELDS_UPDATED: usize = 60;
        const ID: usize = FIELDS_UPDATED + 2;
        const ACCELEROMETER: u16 = 0x007;
        const GYRO: u16 = 0x038;
        // MAVLink 2 cuts trailing zeros, and MAVLink 1 has no id.
        let byte = |at: usize| payload.get(at).copied().unwrap_or(0);
        let flags = u16::from_le_bytes([byte(FIELDS_UPDATED), byte(FIELDS_UPDATED + 1)]);
        let has = |mask: u16| flags == 0 || flags & mask == mask;
        Self { sensor: byte(ID), force: has(ACCELEROMETER), rate: has(GYRO) }
    }
}

/// A sample in mG and mrad/s, as ArduPilot's RAW_IMU and every SCALED_IMU have it.
fn milli(force: [i16; 3], rate: [i16; 3]) -> ImuSample {
    let force = force.map(|mg| f64::from(mg) * 1e-3 * STANDARD_GRAVITY);
    let rate = rate.map(|mrad| f64::from(mrad) * 1e-3);
    (Some(Frd::from(force)), Some(Frd::from(rate)))
}

impl VehicleLog {
    /// Adds a message for which [`is_raw`] holds.
    pub(super) fn add_raw(&mut self, frame_time: FrameTime, frame: &Frame) {
        let Ok(message) = frame.message() else {
            let name = message_name(frame.id());
            self.tally.add(&format!("{name}: payload does not fit its message"), 1);
            return;
        };
        self.messages += 1;
        match message {
            // Only the first group of four belongs to a quadrotor's rotors.
            MavMessage::ESC_STATUS(data) if data.index == 0 => {
                let rpm = data.rpm.map(|rpm| f64::from(rpm).abs());
                let time = Some(data.time_usec as f64 * 1e-6);
                self.keep(Source::EscStatus, frame_time, time, |e, time| e.rpm.push(time, rpm));
            }
            MavMessage::RAW_IMU(d) => {
                let sample = milli([d.xacc, d.yacc, d.zacc], [d.xgyro, d.ygyro, d.zgyro]);
                let time = Some(d.time_usec as f64 * 1e-6);
                self.keep_imu(Source::RawImu, frame_time, time, sample);
            }
            MavMessage::SCALED_IMU(d) => {
                let sample = milli([d.xacc, d.yacc, d.zacc], [d.xgyro, d.ygyro, d.zgyro]);
                self.keep_scaled_imu(Source::ScaledImu, frame_time, d.time_boot_ms, sample);
            }
            MavMessage::SCALED_IMU2(d) => {
                let sample = milli([d.xacc, d.yacc, d.zacc], [d.xgyro, d.ygyro, d.zgyro]);
                self.keep_scaled_imu(Source::ScaledImu2, frame_time, d.time_boot_ms, sample);
            }
            MavMessage::SCALED_IMU3(d) => {
                let sample = milli([d.xacc, d.yacc, d.zacc], [d.xgyro, d.ygyro, d.zgyro]);
                self.keep_scaled_imu(Source::ScaledImu3, frame_time, d.time_boot_ms, sample);
            }
            MavMessage::SERVO_OUTPUT_RAW(data) => {
                self.outputs_waiting.push((frame_time, data));
                let is_full = self.outputs_waiting.len() >= OUTPUTS_WAITING_MAX;
                if is_full || self.codec.knows_time() {
                    self.keep_waiting_outputs();
                }
            }
            // 0 and the largest number mean unknown.
            MavMessage::SYS_STATUS(d) if !matches!(d.voltage_battery, 0 | u16::MAX) => {
                let voltage = f64::from(d.voltage_battery) * 1e-3;
                self.system_voltage.push((frame_time, voltage));
            }
            _ => {}
        }
    }

    /// Adds a sample of a SCALED_IMU. Its stamp wraps every 49.7 days, as that of ATTITUDE does.
    fn keep_scaled_imu(
        &mut self,
        source: Source,
        frame_time: FrameTime,
        time_boot_ms: u32,
        sample: ImuSample,
    ) {
        let time = self.codec.extended_ms(time_boot_ms).as_us() as f64 * 1e-6;
        if self.codec.knows_time() {
            self.keep_waiting_outputs();
        }
        self.keep_imu(source, frame_time, Some(time), sample);
    }

    /// Adds the servo outputs that wait. Their stamps wrap every 71.6 minutes and count on from the
    /// vehicle's newest time, or from 0 if no message states it.
    pub(super) fn keep_waiting_outputs(&mut self) {
        for (frame_time, d) in std::mem::take(&mut self.outputs_waiting) {
            let (source, port) = match d.port {
                0 => (Source::ServoOutputs, 0),
                1 => (Source::ServoOutputsAux, 1),
                _ => continue,
            };
            let first = [d.servo1_raw, d.servo2_raw, d.servo3_raw, d.servo4_raw];
            let next = [d.servo5_raw, d.servo6_raw, d.servo7_raw, d.servo8_raw];
            let third = [d.servo9_raw, d.servo10_raw, d.servo11_raw, d.servo12_raw];
            let last = [d.servo13_raw, d.servo14_raw, d.servo15_raw, d.servo16_raw];
            let groups = [first, next, third, last];
            let outputs = std::array::from_fn(|at| f64::from(groups[at / 4][at % 4]));
            let time = self.codec.extended_us(d.time_usec).as_us() as f64 * 1e-6;
            self.keep(source, frame_time, Some(time), |epoch, time| {
                epoch.servo_outputs[port].push(time, outputs)
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use wire::Encoder;

    use super::super::RAW_IMU;
    use super::*;
    use crate::import::epoch::IMUS;
    use crate::import::flight::Flight;

    /// Every 20 ms for 4 s: `messages` of a vehicle's time since boot, s.
    fn log(boot_s: f64, messages: impl Fn(f64) -> Vec<MavMessage>) -> VehicleLog {
        let (mut log, mut encoder, mut index) = (VehicleLog::default(), Encoder::new(1, 1), 0);
        for step in 0..200 {
            let ground = 0.02 * f64::from(step);
            for message in messages(boot_s + ground) {
                let mut bytes = Vec::new();
                encoder.encode(&message, &mut bytes);
                let frame = Frame::parse(&bytes).expect("a frame");
                index += 1;
                log.add(FrameTime { index, ground }, &frame);
            }
        }
        log
    }

    /// The low 32 bits of a time in ms.
    fn boot_ms(s: f64) -> u32 {
        (s * 1e3).round() as u64 as u32
    }

    fn attitude(s: f64) -> MavMessage {
        let time_boot_ms = boot_ms(s);
        MavMessage::ATTITUDE(ATTITUDE_DATA { time_boot_ms, ..Default::default() })
    }

    /// With every sensor updated.
    fn imu(data: HIGHRES_IMU_DATA) -> MavMessage {
        let fields_updated = HighresImuUpdatedFlags::from_bits_retain(0x3F);
        MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA { fields_updated, ..data })
    }

    #[test]
    fn servo_outputs_before_the_first_stamp_get_the_vehicles_time() {
        // Longer than 32 bits of microseconds last.
        let boot_s = 5000.0;
        let log = log(boot_s, |s| {
            let time_usec = (s * 1e6).round() as u64 as u32;
            let outputs = SERVO_OUTPUT_RAW_DATA { time_usec, ..Default::default() };
            vec![MavMessage::SERVO_OUTPUT_RAW(outputs), attitude(s)]
        });
        let [epoch] = log.epochs.as_slice() else { panic!("{} epochs", log.epochs.len()) };
        assert_eq!(epoch.servo_outputs[0].len(), 200);
        assert!((epoch.servo_outputs[0].times()[0] - boot_s).abs() < 1e-9);
    }

    /// In the middle of the log, 32 bits of milliseconds wrap.
    #[test]
    fn imu_samples_and_voltages_continue_over_a_wrap_of_boot_milliseconds() {
        let boot_s = 4_294_967.296 - 2.0;
        for has_attitude in [false, true] {
            let log = log(boot_s, |s| {
                let (time_boot_ms, time_usec) = (boot_ms(s), (s * 1e6).round() as u64);
                let first = SCALED_IMU_DATA { time_boot_ms, ..Default::default() };
                let second = SCALED_IMU2_DATA { time_boot_ms, ..Default::default() };
                let third = SCALED_IMU3_DATA { time_boot_ms, ..Default::default() };
                let raw = RAW_IMU_DATA { time_usec, ..Default::default() };
                let status = SYS_STATUS_DATA { voltage_battery: 12_000, ..Default::default() };
                let mut messages = vec![
                    MavMessage::SCALED_IMU(first),
                    MavMessage::SCALED_IMU2(second),
                    MavMessage::SCALED_IMU3(third),
                    MavMessage::RAW_IMU(raw),
                    MavMessage::SYS_STATUS(status),
                ];
                messages.extend(has_attitude.then(|| attitude(s)));
                messages
            });
            let [epoch] = log.epochs.as_slice() else { panic!("{} epochs", log.epochs.len()) };
            let is_whole = |times: &[f64]| {
                times.len() == 200
                    && (times[0] - boot_s).abs() < 2e-3
                    && (times[199] - times[0] - 3.98).abs() < 2e-3
            };
            for (imu, source) in epoch.imus.iter().zip(IMUS).skip(RAW_IMU) {
                assert!(is_whole(imu.times()), "{source:?}: {:?}", imu.times());
            }
            let mut flight = Flight::in_memory("memory", "tlog");
            assert!(log.finish(Vec::new(), None, &mut flight).is_ok());
            assert!(is_whole(flight.voltage.times()), "{:?}", flight.voltage.times());
        }
    }

    #[test]
    fn second_sensors_highres_imu_is_left_out() {
        let log = log(10.0, |s| {
            let imu = |id: u8| {
                let time_usec = (s * 1e6) as u64 + u64::from(id) * 100;
                imu(HIGHRES_IMU_DATA { time_usec, xacc: f32::from(id), id, ..Default::default() })
            };
            vec![imu(0), imu(1)]
        });
        let forces = log.epochs[0].imus[0].values().iter().filter_map(|(force, _)| *force);
        let forces: Vec<f64> = forces.map(|force| force.front()).collect();
        assert_eq!(forces, [0.0; 200]);
        let left_out = log.tally.into_vec();
        assert_eq!(left_out, [("HIGHRES_IMU: of sensor 1, where 0 is used".to_owned(), 200)]);
    }

    #[test]
    fn attitude_is_kept_beside_an_imu_that_counts_from_1970() {
        let log = log(100.0, |s| {
            let time_usec = 1_700_000_000_000_000 + (s * 1e6) as u64;
            let imu = imu(HIGHRES_IMU_DATA { time_usec, ..Default::default() });
            vec![attitude(s), imu]
        });
        let [epoch] = log.epochs.as_slice() else { panic!("{} epochs", log.epochs.len()) };
        assert_eq!((epoch.euler.len(), epoch.imus[0].len()), (200, 200));
    }
}
