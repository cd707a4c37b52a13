//! The vehicle's state as MAVLink messages.

#![allow(deprecated, reason = "clients still send and request superseded messages")]

mod geodetic;
mod motors;

use wire::dialect::*;

use crate::config::Home;
use crate::sensors::EstimatorStatus;
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::{MotorOutput, ROTORS};

use self::geodetic::geodetic;
use super::Mode;
use super::offboard::AttitudeSetpoint;
use super::parameters::Parameters;
use super::personality::Personality;
use super::streams::Stream;

/// State of the pack, as reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// Cells in series.
    pub cells: u8,
    /// Terminal voltage, V.
    pub voltage: f64,
    /// Current drawn, A.
    pub current: f64,
    /// Charge drawn since the start, Ah.
    pub consumed_ah: f64,
    /// Remaining charge, 0..1.
    pub remaining: f64,
}

/// The data for all messages at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    pub(super) personality: &'static dyn Personality,
    pub(super) parameters: &'a Parameters,
    /// Vehicle time, us.
    pub now_us: u64,
    /// Reported position, m.
    pub position: Ned,
    /// Reported velocity, m/s.
    pub velocity: Ned,
    /// Reported attitude, body to world.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Accelerometer, m/s^2.
    pub specific_force: Frd,
    /// Motor outputs, 0..1.
    pub outputs: [f64; ROTORS],
    /// Rotor speeds in 1/min, signed by spin; `None` if unknown.
    pub rpm: Option<[f64; ROTORS]>,
    /// The vehicle file's encoding of outputs; `None` for the autopilot's.
    pub motor_output: Option<&'a MotorOutput>,
    /// The active setpoint, if the loop runs.
    pub setpoint: Option<AttitudeSetpoint>,
    /// State of the pack.
    pub battery: Battery,
    /// The autopilot's assessment of the pack.
    pub charge: MavBatteryChargeState,
    /// The estimator's status.
    pub estimator: EstimatorStatus,
    /// Whether the estimator has a position.
    pub position_known: bool,
    /// Whether the position is external and unknown.
    pub lacks_vision: bool,
    /// Whether the motors are armed.
    pub armed: bool,
    /// Active mode.
    pub mode: Mode,
    /// Mode requested last.
    pub intended: Mode,
    /// Whether a failsafe is active.
    pub failsafe: bool,
    /// Whether the vehicle is on the ground.
    pub landed: bool,
    /// Whether arming would succeed.
    pub can_arm: bool,
    /// Position of arming, m.
    pub home: Ned,
    /// Geodetic position of the local frame's origin.
    pub origin: Home,
}

impl Snapshot<'_> {
    /// The message of `stream`; `None` if the vehicle has no data for it.
    pub fn message(&self, stream: Stream) -> Option<MavMessage> {
        Some(match stream {
            Stream::Heartbeat => MavMessage::HEARTBEAT(self.heartbeat()),
            Stream::AttitudeQuaternion => {
                MavMessage::ATTITUDE_QUATERNION(self.attitude_quaternion())
            }
            Stream::Attitude => MavMessage::ATTITUDE(self.attitude_euler()),
            Stream::HighresImu => MavMessage::HIGHRES_IMU(self.highres_imu()),
            Stream::LocalPositionNed if self.position_known => {
                MavMessage::LOCAL_POSITION_NED(self.local_position())
            }
            Stream::LocalPositionNed => return None,
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
                // The vehicle has no clock with the date.
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
            Stream::AutopilotVersion => MavMessage::AUTOPILOT_VERSION(self.personality.version()),
            Stream::ProtocolVersion => MavMessage::PROTOCOL_VERSION(PROTOCOL_VERSION_DATA {
                version: 200,
                min_version: 100,
                max_version: 200,
                ..Default::default()
            }),
            // It has one message for each mode and is sent on request only.
            Stream::AvailableModes => return None,
        })
    }

    fn now_ms(&self) -> u32 {
        (self.now_us / 1000) as u32
    }

    fn heartbeat(&self) -> HEARTBEAT_DATA {
        HEARTBEAT_DATA {
            custom_mode: self.personality.custom_mode(self.mode),
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: self.personality.autopilot(),
            base_mode: self.personality.base_mode(self.mode, self.armed),
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
        // In the local frame, as child_frame_id states; PX4 was measured to send it so.
        let [vx, vy, vz] = floats(self.velocity.to_array());
        let [rollspeed, pitchspeed, yawspeed] = floats(self.body_rate.to_array());
        // NaN in the first element means that the covariance is unknown.
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
            reset_counter: self.estimator.reset_count,
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_AUTOPILOT,
            quality: 100,
        }
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
        let gps = self.position_known && !self.estimator.rejects_gps;
        health.set(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS, gps);
        let charged = self.charge == MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK;
        health.set(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_BATTERY, charged);
        let position = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL;
        let mut enabled = present;
        health.set(position, !self.lacks_vision);
        if !self.personality.controls_position(self.mode) {
            enabled.remove(position);
            health.remove(position);
        }
        SYS_STATUS_DATA {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: enabled,
            onboard_control_sensors_health: health,
            load: 100,
            voltage_battery: (self.battery.voltage * 1e3).round() as u16,
            current_battery: (self.battery.current * 100.0).round() as i16,
            battery_remaining: (self.battery.remaining * 100.0).round() as i8,
            // The default of a flag set is its first flag, not the empty set.
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
            charge_state: self.charge,
            // The default of a flag set is its first flag, not the empty set.
            fault_bitmask: MavBatteryFault::empty(),
            ..Default::default()
        }
    }

    fn current_mode(&self) -> CURRENT_MODE_DATA {
        CURRENT_MODE_DATA {
            custom_mode: self.personality.custom_mode(self.mode),
            intended_custom_mode: self.personality.custom_mode(self.intended),
            standard_mode: self.personality.standard_mode(self.mode),
        }
    }
}

fn floats<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}
