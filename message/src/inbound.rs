//! What a vehicle says, in SI units and typed frames. The dialect's types stop here.

use vehicle::frame::{Attitude, Frd, Ned};

/// The messages of an autopilot that are understood.
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
        /// What the vehicle says of itself as a whole.
        system: SystemState,
    },
    /// CURRENT_MODE.
    CurrentMode {
        /// The mode in force.
        custom_mode: u32,
        /// The mode that was asked for last.
        intended_custom_mode: u32,
    },
    /// A word of the mode that gives a permission, and may be a copy of an old one: which mode is in
    /// force is not known until the next.
    DoubtfulMode,
    /// ATTITUDE_QUATERNION or ATTITUDE.
    Attitude {
        /// Which of the two: their estimates are never mixed.
        source: AttitudeSource,
        /// Body to world.
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
    /// ODOMETRY, with pose and velocity in world NED whatever its child frame was.
    Odometry {
        /// Position, m.
        position: Ned,
        /// Velocity in world axes, m/s.
        velocity: Ned,
        /// Body to world.
        attitude: Attitude,
        /// Body rate, rad/s.
        body_rate: Frd,
        /// Counts jumps of the estimate.
        reset_counter: u8,
    },
    /// HIGHRES_IMU, accelerometer and gyro.
    Imu {
        /// Specific force, m/s^2; (0, 0, -g) at hover.
        specific_force: Frd,
        /// Body rate, rad/s.
        body_rate: Frd,
    },
    /// ACTUATOR_OUTPUT_STATUS or SERVO_OUTPUT_RAW, as sent.
    MotorOutputs {
        /// Which of the two: their units differ.
        source: MotorSource,
        /// The first outputs of the message.
        outputs: [f32; 4],
    },
    /// BATTERY_STATUS.
    Battery(Battery),
    /// ATTITUDE_TARGET: the vehicle's echo of the setpoint in force.
    AttitudeTarget {
        /// Desired body to world, where valid.
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
        /// Health bits.
        health: u32,
        /// Bits of what is enabled: what is not in use need not be healthy.
        enabled: u32,
    },
    /// EXTENDED_SYS_STATE.
    LandedState(LandedState),
    /// STATUSTEXT, chunks joined.
    StatusText {
        /// MAV_SEVERITY: 0 emergency to 7 debug.
        severity: u8,
        /// The text.
        text: String,
    },
    /// AUTOPILOT_VERSION.
    AutopilotVersion {
        /// Vendor of the board.
        vendor_id: u16,
        /// Product of the vendor.
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
    /// PARAM_VALUE, undone from PX4's byte cast where the type says integer.
    Parameter {
        /// Name.
        name: String,
        /// Value.
        value: f64,
    },
}

/// Where an attitude came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttitudeSource {
    /// ATTITUDE_QUATERNION.
    Quaternion,
    /// ATTITUDE (Euler angles).
    Euler,
}

/// Where motor outputs came from.
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
    /// Not known.
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

/// The pack, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Battery {
    /// V
    pub voltage: Option<f64>,
    /// A
    pub current: Option<f64>,
    /// Remaining charge, 0..1.
    pub remaining: Option<f64>,
    /// What the vehicle makes of it.
    pub charge: ChargeState,
}

/// BATTERY_STATUS.charge_state, by what follows from it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChargeState {
    /// Not told.
    #[default]
    Unknown,
    /// Nothing follows: in use or charging.
    Ok,
    /// Low: to be watched.
    Low,
    /// Critical, in an emergency, failed or unhealthy: to be landed with.
    Critical,
}

/// HEARTBEAT.system_status (MAV_STATE), by what follows from it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SystemState {
    /// Not told, or not one that matters here.
    #[default]
    Unknown,
    /// On the ground, ready to fly.
    Standby,
    /// Flying.
    Active,
    /// The vehicle is in a failsafe: critical, in an emergency, or ending its flight.
    Failsafe,
}

impl SystemState {
    /// Whether the vehicle is in a failsafe.
    pub fn is_failsafe(self) -> bool {
        self == Self::Failsafe
    }
}

impl From<u8> for SystemState {
    /// From MAV_STATE.
    fn from(state: u8) -> Self {
        match state {
            3 => Self::Standby,
            4 => Self::Active,
            5 | 6 | 8 => Self::Failsafe,
            _ => Self::Unknown,
        }
    }
}
