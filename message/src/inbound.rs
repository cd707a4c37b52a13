//! Messages from a vehicle, in SI units and typed frames. The dialect's types end here.

use vehicle::frame::{Attitude, Frd, Ned};

/// A decoded message from an autopilot.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Inbound {
    /// HEARTBEAT of the vehicle's autopilot.
    Heartbeat {
        /// MAV_AUTOPILOT.
        autopilot: u8,
        /// MAV_TYPE.
        vehicle_type: u8,
        /// Whether the motors are armed.
        armed: bool,
        /// Autopilot-specific mode.
        custom_mode: u32,
        /// Overall state of the system.
        system: SystemState,
    },
    /// CURRENT_MODE.
    CurrentMode {
        /// The active mode.
        custom_mode: u32,
        /// The mode requested last.
        intended_custom_mode: u32,
    },
    /// A report of a mode that grants permission and may be a delayed duplicate. The active mode is
    /// unknown until the next report.
    DoubtfulMode,
    /// A HEARTBEAT that reports stopped motors, out of order: it may be an old one. Whether they are
    /// armed is unknown until the next HEARTBEAT.
    DoubtfulArming,
    /// ATTITUDE_QUATERNION or ATTITUDE.
    Attitude {
        /// Which of the two messages; their estimates are never mixed.
        source: AttitudeSource,
        /// Attitude, body to world.
        attitude: Attitude,
        /// Body rate, rad/s.
        body_rate: Frd,
    },
    /// LOCAL_POSITION_NED.
    LocalPosition {
        /// Position, m.
        position: Ned,
        /// Velocity, m/s.
        velocity: Ned,
    },
    /// ODOMETRY, with pose and velocity in world NED, whatever its child frame.
    Odometry {
        /// Position, m.
        position: Ned,
        /// Velocity in world axes, m/s.
        velocity: Ned,
        /// Attitude, body to world.
        attitude: Attitude,
        /// Body rate, rad/s.
        body_rate: Frd,
        /// Counts resets of the estimate, modulo 256.
        reset_counter: u8,
    },
    /// Accelerometer and gyro of HIGHRES_IMU.
    Imu {
        /// Specific force, m/s^2; (0, 0, -g) at hover.
        specific_force: Frd,
        /// Body rate, rad/s.
        body_rate: Frd,
    },
    /// ACTUATOR_OUTPUT_STATUS or SERVO_OUTPUT_RAW, in the message's units.
    MotorOutputs {
        /// Which of the two messages; their units differ.
        source: MotorSource,
        /// The first four outputs of the message.
        outputs: [f32; 4],
    },
    /// BATTERY_STATUS.
    Battery(Battery),
    /// ATTITUDE_TARGET: the vehicle's echo of the active setpoint.
    AttitudeTarget {
        /// Desired attitude, body to world; `None` if invalid.
        attitude: Option<Attitude>,
        /// Desired body rate, rad/s.
        body_rate: Frd,
        /// Normalised collective thrust.
        thrust: f64,
        /// Type mask.
        type_mask: u8,
    },
    /// SYS_STATUS.
    SysStatus {
        /// Sensors that are present and enabled but not healthy, MAV_SYS_STATUS_SENSOR bits.
        unhealthy: u32,
        /// Health, MAV_SYS_STATUS_SENSOR bits.
        health: u32,
        /// Enabled sensors, MAV_SYS_STATUS_SENSOR bits. A sensor that is not enabled need not be
        /// healthy.
        enabled: u32,
    },
    /// EXTENDED_SYS_STATE.
    LandedState(LandedState),
    /// STATUSTEXT, with its chunks joined.
    StatusText {
        /// MAV_SEVERITY: 0 emergency to 7 debug.
        severity: u8,
        /// The text.
        text: String,
    },
    /// AUTOPILOT_VERSION.
    AutopilotVersion {
        /// Board vendor.
        vendor_id: u16,
        /// Product of that vendor.
        product_id: u16,
        /// Firmware version as major, minor, patch, type from the highest byte.
        flight_sw_version: u32,
    },
    /// COMMAND_ACK.
    CommandAck {
        /// MAV_CMD.
        command: u16,
        /// MAV_RESULT.
        result: u8,
    },
    /// PARAM_VALUE, with integers decoded from PX4's bytewise encoding.
    Parameter {
        /// Name.
        name: String,
        /// Value.
        value: f64,
    },
}

/// Message that carried an attitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttitudeSource {
    /// ATTITUDE_QUATERNION.
    Quaternion,
    /// ATTITUDE (Euler angles).
    Euler,
}

/// Message that carried motor outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotorSource {
    /// ACTUATOR_OUTPUT_STATUS.
    ActuatorOutputStatus,
    /// SERVO_OUTPUT_RAW, microseconds of pulse width.
    ServoOutputRaw,
}

/// EXTENDED_SYS_STATE.landed_state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LandedState {
    /// The autopilot does not know.
    Undefined,
    /// On the ground.
    OnGround,
    /// In the air.
    InAir,
    /// Taking off.
    TakingOff,
    /// Landing.
    Landing,
}

/// State of the battery pack, as far as reported.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Battery {
    /// Voltage of the pack, V.
    pub voltage: Option<f64>,
    /// Current, A.
    pub current: Option<f64>,
    /// Remaining charge, 0..1.
    pub remaining: Option<f64>,
    /// The vehicle's verdict on the charge.
    pub charge: ChargeState,
}

/// BATTERY_STATUS.charge_state, grouped by consequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChargeState {
    /// Not reported.
    #[default]
    Unknown,
    /// No consequence: in use or charging.
    Ok,
    /// Low: watch it.
    Low,
    /// Critical, emergency, failed or unhealthy: land.
    Critical,
}

/// HEARTBEAT.system_status (MAV_STATE), grouped by consequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SystemState {
    /// Not reported, or irrelevant here.
    #[default]
    Unknown,
    /// On the ground, ready to fly.
    Standby,
    /// Flying.
    Active,
    /// In a failsafe: critical, emergency, or flight termination.
    Failsafe,
}

impl SystemState {
    /// Whether the vehicle is in a failsafe.
    pub fn is_failsafe(self) -> bool {
        self == Self::Failsafe
    }
}

impl From<u8> for SystemState {
    /// Converts a MAV_STATE.
    fn from(state: u8) -> Self {
        match state {
            3 => Self::Standby,
            4 => Self::Active,
            5 | 6 | 8 => Self::Failsafe,
            _ => Self::Unknown,
        }
    }
}
