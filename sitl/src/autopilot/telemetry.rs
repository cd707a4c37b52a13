//! The vehicle's state as MAVLink messages.

#![allow(deprecated, reason = "clients still send and ask for superseded messages")]

use wire::dialect::*;

use crate::config::Home;
use crate::frame::{Attitude, Euler, Frd, Ned};
use crate::vehicle::{MotorOutput, ROTORS};

use super::Mode;
use super::offboard::AttitudeSetpoint;
use super::streams::Stream;

/// What AUTOPILOT_VERSION says about the vehicle: it takes attitude, rates and thrust together, as
/// a PD.
pub const VENDOR_ID: u16 = 0x4457;
/// See [`VENDOR_ID`].
pub const PRODUCT_ID: u16 = 1;

/// Version that the vehicle reports, major, minor, patch, and 255 for a release: the PX4 whose
/// protocol it follows.
const FLIGHT_SW_VERSION: u32 = u32::from_be_bytes([1, 17, 0, 255]);

/// Radius of the earth for the local tangent plane, m (PX4's).
const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// Latitude and longitude in 1e-7 degrees and altitude in mm of the place at `offset` from
/// `origin`, on the tangent plane.
fn geodetic(origin: &Home, offset: Ned) -> [i32; 3] {
    let north = (offset.north() / EARTH_RADIUS_M).to_degrees();
    let parallel = EARTH_RADIUS_M * origin.latitude_deg.to_radians().cos();
    let east = (offset.east() / parallel).to_degrees();
    let altitude_m = origin.altitude_m - offset.down();
    let wire = [
        (origin.latitude_deg + north) * 1e7,
        (origin.longitude_deg + east) * 1e7,
        altitude_m * 1e3,
    ];
    wire.map(|value| value.round() as i32)
}

/// The pack as reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// Cells in series.
    pub cells: u8,
    /// Terminal voltage, V.
    pub voltage: f64,
    /// Current drawn, A.
    pub current: f64,
    /// Charge drawn since it was full, Ah.
    pub consumed_ah: f64,
    /// Remaining charge, 0..1.
    pub remaining: f64,
}

/// Everything that the messages say, at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Vehicle time, us.
    pub now_us: u64,
    /// Reported position, m.
    pub position: Ned,
    /// Reported velocity, m/s.
    pub velocity: Ned,
    /// Reported attitude.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Accelerometer, m/s^2.
    pub specific_force: Frd,
    /// Motor outputs in force, 0..1.
    pub outputs: [f64; ROTORS],
    /// Rotor speeds, rpm, sign is spin; `None` where not known.
    pub rpm: Option<[f64; ROTORS]>,
    /// How outputs are encoded; `None` for 0..1.
    pub motor_output: Option<&'a MotorOutput>,
    /// The setpoint in force, if the loop runs.
    pub setpoint: Option<&'a AttitudeSetpoint>,
    /// The pack.
    pub battery: Battery,
    /// Whether the motors are armed.
    pub armed: bool,
    /// Mode in force.
    pub mode: Mode,
    /// Mode asked for.
    pub intended: Mode,
    /// Whether a failsafe is active.
    pub failsafe: bool,
    /// Whether the vehicle stands on the ground.
    pub landed: bool,
    /// Whether arming would succeed.
    pub can_arm: bool,
    /// Point of arming, m.
    pub home: Ned,
    /// Place of the local frame's origin.
    pub origin: Home,
}

impl Snapshot<'_> {
    /// The message of `stream`; `None` where the vehicle has nothing to say in it.
    pub fn message(&self, stream: Stream) -> Option<MavMessage> {
        Some(match stream {
            Stream::Heartbeat => MavMessage::HEARTBEAT(self.heartbeat()),
            Stream::AttitudeQuaternion => {
                MavMessage::ATTITUDE_QUATERNION(self.attitude_quaternion())
            }
            Stream::Attitude => MavMessage::ATTITUDE(self.attitude_euler()),
            Stream::HighresImu => MavMessage::HIGHRES_IMU(self.highres_imu()),
            Stream::LocalPositionNed => MavMessage::LOCAL_POSITION_NED(self.local_position()),
            Stream::Odometry => MavMessage::ODOMETRY(self.odometry()),
            Stream::ActuatorOutputStatus => {
                MavMessage::ACTUATOR_OUTPUT_STATUS(self.actuator_output_status())
            }
            Stream::AttitudeTarget => MavMessage::ATTITUDE_TARGET(self.attitude_target()?),
            Stream::ServoOutputRaw => MavMessage::SERVO_OUTPUT_RAW(self.servo_output_raw()),
            Stream::EscStatus => MavMessage::ESC_STATUS(self.esc_status()?),
            Stream::Timesync => MavMessage::TIMESYNC(TIMESYNC_DATA {
                ts1: (self.now_us * 1000).cast_signed(),
                ..Default::default()
            }),
            Stream::GlobalPositionInt => MavMessage::GLOBAL_POSITION_INT(self.global_position()),
            Stream::VfrHud => MavMessage::VFR_HUD(self.vfr_hud()),
            Stream::Altitude => MavMessage::ALTITUDE(self.altitude()),
            Stream::SysStatus => MavMessage::SYS_STATUS(self.sys_status()),
            Stream::ExtendedSysState => MavMessage::EXTENDED_SYS_STATE(self.extended_sys_state()),
            Stream::GpsRawInt => MavMessage::GPS_RAW_INT(self.gps_raw()),
            Stream::SystemTime => MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
                // No clock on board knows the date.
                time_unix_usec: 0,
                time_boot_ms: self.now_ms(),
            }),
            Stream::BatteryStatus => MavMessage::BATTERY_STATUS(self.battery_status()),
            Stream::CurrentMode => MavMessage::CURRENT_MODE(self.current_mode()),
            Stream::HomePosition => MavMessage::HOME_POSITION(self.home_position()),
            Stream::GpsGlobalOrigin => {
                let [latitude, longitude, altitude] = geodetic(&self.origin, Ned::zero());
                let time_usec = self.now_us;
                MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
                    latitude,
                    longitude,
                    altitude,
                    time_usec,
                })
            }
            Stream::AutopilotVersion => MavMessage::AUTOPILOT_VERSION(autopilot_version()),
            Stream::ProtocolVersion => MavMessage::PROTOCOL_VERSION(PROTOCOL_VERSION_DATA {
                version: 200,
                min_version: 100,
                max_version: 200,
                ..Default::default()
            }),
            // One message a mode: sent by request, not from here.
            Stream::AvailableModes => return None,
        })
    }

    fn now_ms(&self) -> u32 {
        (self.now_us / 1000) as u32
    }

    fn heartbeat(&self) -> HEARTBEAT_DATA {
        HEARTBEAT_DATA {
            custom_mode: self.mode.custom_mode(),
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            base_mode: self.mode.base_mode(self.armed),
            system_status: match (self.armed, self.failsafe) {
                (false, _) => MavState::MAV_STATE_STANDBY,
                (true, false) => MavState::MAV_STATE_ACTIVE,
                (true, true) => MavState::MAV_STATE_CRITICAL,
            },
            mavlink_version: 3,
        }
    }

    fn attitude_quaternion(&self) -> ATTITUDE_QUATERNION_DATA {
        let [q1, q2, q3, q4] = self.attitude.to_wire();
        let [rollspeed, pitchspeed, yawspeed] = floats(self.body_rate.to_array());
        ATTITUDE_QUATERNION_DATA {
            time_boot_ms: self.now_ms(),
            q1,
            q2,
            q3,
            q4,
            rollspeed,
            pitchspeed,
            yawspeed,
            ..Default::default()
        }
    }

    fn attitude_euler(&self) -> ATTITUDE_DATA {
        let Euler { roll, pitch, yaw } = self.attitude.euler();
        let [roll, pitch, yaw] = floats([roll, pitch, yaw]);
        let [rollspeed, pitchspeed, yawspeed] = floats(self.body_rate.to_array());
        let time_boot_ms = self.now_ms();
        ATTITUDE_DATA { time_boot_ms, roll, pitch, yaw, rollspeed, pitchspeed, yawspeed }
    }

    fn highres_imu(&self) -> HIGHRES_IMU_DATA {
        let [xacc, yacc, zacc] = floats(self.specific_force.to_array());
        let [xgyro, ygyro, zgyro] = floats(self.body_rate.to_array());
        HIGHRES_IMU_DATA {
            time_usec: self.now_us,
            xacc,
            yacc,
            zacc,
            xgyro,
            ygyro,
            zgyro,
            fields_updated: HighresImuUpdatedFlags::from_bits_retain(0x3F),
            ..Default::default()
        }
    }

    fn local_position(&self) -> LOCAL_POSITION_NED_DATA {
        let [x, y, z] = floats(self.position.to_array());
        let [vx, vy, vz] = floats(self.velocity.to_array());
        LOCAL_POSITION_NED_DATA { time_boot_ms: self.now_ms(), x, y, z, vx, vy, vz }
    }

    fn odometry(&self) -> ODOMETRY_DATA {
        let [x, y, z] = floats(self.position.to_array());
        // In the local frame, as child_frame_id says: what PX4 was measured to send.
        let [vx, vy, vz] = floats(self.velocity.to_array());
        let [rollspeed, pitchspeed, yawspeed] = floats(self.body_rate.to_array());
        // NaN in the first element: the covariance is not known.
        let mut unknown = [0.0; 21];
        unknown[0] = f32::NAN;
        ODOMETRY_DATA {
            time_usec: self.now_us,
            x,
            y,
            z,
            q: self.attitude.to_wire(),
            vx,
            vy,
            vz,
            rollspeed,
            pitchspeed,
            yawspeed,
            pose_covariance: unknown,
            velocity_covariance: unknown,
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            reset_counter: 0,
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_AUTOPILOT,
            quality: 100,
        }
    }

    /// The outputs as `message` carries them, each with its slot: as the vehicle file describes
    /// them where it describes this message, else between `otherwise`'s zero, one and disarmed.
    fn encoded_outputs(&self, message: &str, otherwise: [f64; 3]) -> [(usize, f64); ROTORS] {
        let described = self.motor_output.filter(|described| described.message == message);
        let [zero, one, disarmed] = described
            .map_or(otherwise, |described| [described.zero, described.one, described.disarmed]);
        std::array::from_fn(|rotor| {
            let field = described.and_then(|described| described.fields.get(rotor));
            let slot = field.and_then(|field| slot_of(field)).unwrap_or(rotor);
            let output = self.outputs[rotor];
            (slot, if self.armed { zero + output * (one - zero) } else { disarmed })
        })
    }

    fn actuator_output_status(&self) -> ACTUATOR_OUTPUT_STATUS_DATA {
        let mut actuator = [0.0; 32];
        let mut active = 0;
        for (slot, value) in self.encoded_outputs("ACTUATOR_OUTPUT_STATUS", [0.0, 1.0, 0.0]) {
            if let Some(place) = actuator.get_mut(slot) {
                *place = value as f32;
                active |= 1 << slot;
            }
        }
        ACTUATOR_OUTPUT_STATUS_DATA { time_usec: self.now_us, active, actuator }
    }

    fn attitude_target(&self) -> Option<ATTITUDE_TARGET_DATA> {
        let setpoint = self.setpoint?;
        let attitude = setpoint.attitude.map_or_else(Attitude::default, Euler::attitude);
        let [body_roll_rate, body_pitch_rate, body_yaw_rate] =
            floats(setpoint.body_rate.to_array());
        Some(ATTITUDE_TARGET_DATA {
            time_boot_ms: self.now_ms(),
            q: attitude.to_wire(),
            body_roll_rate,
            body_pitch_rate,
            body_yaw_rate,
            thrust: setpoint.thrust as f32,
            type_mask: setpoint.type_mask,
        })
    }

    fn servo_output_raw(&self) -> SERVO_OUTPUT_RAW_DATA {
        let mut pwm = [0; 8];
        for (slot, value) in self.encoded_outputs("SERVO_OUTPUT_RAW", [1000.0, 2000.0, 900.0]) {
            if let Some(place) = pwm.get_mut(slot) {
                *place = value.round() as u16;
            }
        }
        SERVO_OUTPUT_RAW_DATA {
            time_usec: self.now_us as u32,
            servo1_raw: pwm[0],
            servo2_raw: pwm[1],
            servo3_raw: pwm[2],
            servo4_raw: pwm[3],
            servo5_raw: pwm[4],
            servo6_raw: pwm[5],
            servo7_raw: pwm[6],
            servo8_raw: pwm[7],
            ..Default::default()
        }
    }

    fn esc_status(&self) -> Option<ESC_STATUS_DATA> {
        let rpm = self.rpm?.map(|rpm| rpm.round() as i32);
        let voltage = [self.battery.voltage as f32; ROTORS];
        let current = [(self.battery.current / ROTORS as f64) as f32; ROTORS];
        Some(ESC_STATUS_DATA { time_usec: self.now_us, rpm, voltage, current, index: 0 })
    }

    fn global_position(&self) -> GLOBAL_POSITION_INT_DATA {
        let [lat, lon, alt] = geodetic(&self.origin, self.position);
        let [vx, vy, vz] = self.velocity.to_array().map(|v| (v * 100.0).round() as i16);
        GLOBAL_POSITION_INT_DATA {
            time_boot_ms: self.now_ms(),
            lat,
            lon,
            alt,
            relative_alt: (self.height() * 1e3).round() as i32,
            vx,
            vy,
            vz,
            hdg: self.heading_cdeg(),
        }
    }

    /// Height above home, m.
    fn height(&self) -> f64 {
        self.home.down() - self.position.down()
    }

    fn heading_cdeg(&self) -> u16 {
        let degrees = self.attitude.euler().yaw.to_degrees().rem_euclid(360.0);
        ((degrees * 100.0).round() as u16) % 36_000
    }

    fn gps_raw(&self) -> GPS_RAW_INT_DATA {
        let [lat, lon, alt] = geodetic(&self.origin, self.position);
        let speed = self.velocity.north().hypot(self.velocity.east());
        let course = self.velocity.east().atan2(self.velocity.north()).to_degrees();
        GPS_RAW_INT_DATA {
            time_usec: self.now_us,
            lat,
            lon,
            alt,
            eph: 70,
            epv: 90,
            vel: (speed * 100.0).round() as u16,
            cog: (course.rem_euclid(360.0) * 100.0).round() as u16 % 36_000,
            fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
            satellites_visible: 12,
            alt_ellipsoid: alt,
            h_acc: 300,
            v_acc: 400,
            vel_acc: 50,
            ..Default::default()
        }
    }

    fn vfr_hud(&self) -> VFR_HUD_DATA {
        let throttle = self.outputs.iter().sum::<f64>() / ROTORS as f64;
        VFR_HUD_DATA {
            groundspeed: self.velocity.north().hypot(self.velocity.east()) as f32,
            alt: (self.origin.altitude_m - self.position.down()) as f32,
            climb: -self.velocity.down() as f32,
            heading: (self.heading_cdeg() / 100).cast_signed(),
            throttle: (throttle * 100.0).round() as u16,
            ..Default::default()
        }
    }

    fn altitude(&self) -> ALTITUDE_DATA {
        let amsl = (self.origin.altitude_m - self.position.down()) as f32;
        ALTITUDE_DATA {
            time_usec: self.now_us,
            altitude_monotonic: amsl,
            altitude_amsl: amsl,
            altitude_local: -self.position.down() as f32,
            altitude_relative: self.height() as f32,
            altitude_terrain: f32::NAN,
            bottom_clearance: f32::NAN,
        }
    }

    fn sys_status(&self) -> SYS_STATUS_DATA {
        let present = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_EXTERNAL_GROUND_TRUTH
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_YAW_POSITION
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
            | MavSysStatusSensor::MAV_SYS_STATUS_AHRS
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_BATTERY
            | MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK;
        let mut health = present;
        health.set(MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK, self.can_arm);
        SYS_STATUS_DATA {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: present,
            onboard_control_sensors_health: health,
            load: 100,
            voltage_battery: (self.battery.voltage * 1e3).round() as u16,
            current_battery: (self.battery.current * 100.0).round() as i16,
            battery_remaining: (self.battery.remaining * 100.0).round() as i8,
            // The default of a set of flags is its first flag.
            onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
            ..Default::default()
        }
    }

    fn extended_sys_state(&self) -> EXTENDED_SYS_STATE_DATA {
        EXTENDED_SYS_STATE_DATA {
            vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
            landed_state: match (self.landed, self.mode) {
                (true, _) => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
                (false, Mode::Takeoff) => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
                (false, Mode::Land) => MavLandedState::MAV_LANDED_STATE_LANDING,
                (false, _) => MavLandedState::MAV_LANDED_STATE_IN_AIR,
            },
        }
    }

    fn battery_status(&self) -> BATTERY_STATUS_DATA {
        let Battery { cells, voltage, current, consumed_ah, remaining } = self.battery;
        let mut voltages = [u16::MAX; 10];
        let cell_mv = (voltage / f64::from(cells.max(1)) * 1e3).round() as u16;
        voltages.iter_mut().take(cells.into()).for_each(|v| *v = cell_mv);
        BATTERY_STATUS_DATA {
            current_consumed: (consumed_ah * 1e3).round() as i32,
            energy_consumed: -1,
            temperature: i16::MAX,
            voltages,
            current_battery: (current * 100.0).round() as i16,
            battery_function: MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL,
            mavtype: MavBatteryType::MAV_BATTERY_TYPE_LIPO,
            battery_remaining: (remaining * 100.0).round() as i8,
            charge_state: MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK,
            // The default of a set of flags is its first flag.
            fault_bitmask: MavBatteryFault::empty(),
            ..Default::default()
        }
    }

    fn current_mode(&self) -> CURRENT_MODE_DATA {
        CURRENT_MODE_DATA {
            custom_mode: self.mode.custom_mode(),
            intended_custom_mode: self.intended.custom_mode(),
            standard_mode: self.mode.standard_mode(),
        }
    }

    fn home_position(&self) -> HOME_POSITION_DATA {
        let [latitude, longitude, altitude] = geodetic(&self.origin, self.home);
        let [x, y, z] = floats(self.home.to_array());
        HOME_POSITION_DATA {
            latitude,
            longitude,
            altitude,
            x,
            y,
            z,
            q: [1.0, 0.0, 0.0, 0.0],
            time_usec: self.now_us,
            ..Default::default()
        }
    }
}

fn floats<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

/// Slot of a field such as `actuator[2]`, counted from 0, or `servo3_raw`, counted from 1.
fn slot_of(field: &str) -> Option<usize> {
    let digits = &field[field.find(|c: char| c.is_ascii_digit())?..];
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    let number: usize = digits[..end].parse().ok()?;
    if field.starts_with("servo") { number.checked_sub(1) } else { Some(number) }
}

fn autopilot_version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        flight_sw_version: FLIGHT_SW_VERSION,
        vendor_id: VENDOR_ID,
        product_id: PRODUCT_ID,
        uid: u64::from(VENDOR_ID) << 16 | u64::from(PRODUCT_ID),
        ..Default::default()
    }
}

/// AVAILABLE_MODES of the mode at `index` (from 1, as the message counts).
pub fn available_mode(index: usize) -> Option<MavMessage> {
    let mode = Mode::ALL.get(index.checked_sub(1)?)?;
    let mut properties = MavModeProperty::empty();
    properties.set(MavModeProperty::MAV_MODE_PROPERTY_AUTO_MODE, *mode != Mode::Position);
    Some(MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
        custom_mode: mode.custom_mode(),
        properties,
        number_modes: Mode::ALL.len() as u8,
        mode_index: index as u8,
        standard_mode: mode.standard_mode(),
        mode_name: mode.to_string().as_str().into(),
    }))
}

/// A text in as many STATUSTEXT as it needs. `id` ties the chunks; it is 0 where one suffices.
pub fn status_text(
    severity: MavSeverity,
    text: &str,
    id: u16,
) -> impl Iterator<Item = MavMessage> + '_ {
    const CHUNK: usize = 50;
    let id = if text.len() > CHUNK { id.max(1) } else { 0 };
    text.as_bytes().chunks(CHUNK).enumerate().map(move |(sequence, chunk)| {
        let mut data = [0; CHUNK];
        data[..chunk.len()].copy_from_slice(chunk);
        MavMessage::STATUSTEXT(STATUSTEXT_DATA {
            severity,
            text: data.into(),
            id,
            chunk_seq: sequence as u8,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_chunked_and_short_ones_are_not() {
        let long = "x".repeat(120);
        let chunks: Vec<_> = status_text(MavSeverity::MAV_SEVERITY_INFO, &long, 7).collect();
        assert_eq!(chunks.len(), 3);
        let MavMessage::STATUSTEXT(last) = &chunks[2] else { panic!("not a text") };
        assert_eq!(
            (last.id, last.chunk_seq, last.text.to_str()),
            (7, 2, Ok("x".repeat(20).as_str()))
        );
        let mut short = status_text(MavSeverity::MAV_SEVERITY_INFO, "hi", 7);
        let Some(MavMessage::STATUSTEXT(only)) = short.next() else { panic!("not a text") };
        assert_eq!(only.id, 0);
        assert!(short.next().is_none());
    }

    #[test]
    fn a_degree_north_is_111_km() {
        let origin = Home { latitude_deg: 47.0, longitude_deg: 8.0, altitude_m: 400.0 };
        let [latitude, longitude, altitude] = geodetic(&origin, Ned::new(111_195.0, 0.0, -10.0));
        assert!((latitude - 480_000_000).abs() < 1000);
        assert_eq!((longitude, altitude), (80_000_000, 410_000));
    }

    #[test]
    fn fields_of_motor_messages_name_their_slots() {
        assert_eq!(slot_of("actuator[2]"), Some(2));
        assert_eq!(slot_of("servo3_raw"), Some(2));
        assert_eq!(slot_of("servo0_raw"), None);
        assert_eq!(slot_of("motor"), None);
    }

    #[test]
    fn every_mode_is_available_and_no_more() {
        assert!(available_mode(0).is_none());
        assert!((1..=Mode::ALL.len()).all(|index| available_mode(index).is_some()));
        assert!(available_mode(Mode::ALL.len() + 1).is_none());
    }
}
