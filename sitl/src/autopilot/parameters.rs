//! The parameter table: names, types and ranges as PX4 has them, a few of this vehicle's own, and
//! PX4's byte cast of integers into the protocol's float.

use wire::dialect::MavParamType;

use crate::vehicle::{AttitudePd, VehicleParams};

/// Every parameter, in the order of their indices on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the table below describes each")]
pub enum Key {
    Bat1NCells,
    ComArmLevel,
    ComDisarmLand,
    ComDisarmPrflt,
    ComLowBatAct,
    ComOblRcAct,
    ComOfLossT,
    ComRcInMode,
    ComRcLossT,
    ComRcOverride,
    DwKdPitch,
    DwKdRoll,
    DwKdYaw,
    DwKpPitch,
    DwKpRoll,
    DwKpYaw,
    DwPdRate,
    DwThrustMax,
    MavCompId,
    MavProtoVer,
    MavSysId,
    MavType,
    MisTakeoffAlt,
    MpcLandSpeed,
    MpcThrHover,
    MpcTiltMaxAir,
    MpcTkoSpeed,
    MpcXyVelMax,
    MpcZVelMaxDn,
    MpcZVelMaxUp,
    NavDllAct,
    NavRclAct,
    SysAutostart,
}

/// A value with its wire type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// INT32.
    Int(i32),
    /// REAL32.
    Float(f32),
}

impl Value {
    /// The protocol's float: an integer's four bytes are reinterpreted, not converted, so that 5
    /// reads 7.0e-45.
    pub fn to_wire(self) -> (f32, MavParamType) {
        match self {
            Self::Int(value) => {
                (f32::from_bits(value.cast_unsigned()), MavParamType::MAV_PARAM_TYPE_INT32)
            }
            Self::Float(value) => (value, MavParamType::MAV_PARAM_TYPE_REAL32),
        }
    }

    /// Undoes [`Value::to_wire`]; `None` for a type that no parameter here has.
    pub fn from_wire(value: f32, kind: MavParamType) -> Option<Self> {
        match kind {
            MavParamType::MAV_PARAM_TYPE_INT32 => Some(Self::Int(value.to_bits().cast_signed())),
            MavParamType::MAV_PARAM_TYPE_REAL32 => Some(Self::Float(value)),
            _ => None,
        }
    }

    fn as_f64(self) -> f64 {
        match self {
            Self::Int(value) => value.into(),
            Self::Float(value) => value.into(),
        }
    }
}

/// Why a parameter was not set.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetError {
    /// No such name.
    #[error("no parameter of this name")]
    Unknown,
    /// The type on the wire is not the parameter's.
    #[error("wrong type")]
    Type,
    /// Not finite, or outside the range.
    #[error("out of range {min}..{max}")]
    Range {
        /// Least value.
        min: f64,
        /// Greatest value.
        max: f64,
    },
    /// It tells about the vehicle file and cannot be set.
    #[error("read only")]
    ReadOnly,
}

struct Spec {
    key: Key,
    name: &'static str,
    default: Value,
    min: f64,
    max: f64,
    writable: bool,
}

const fn float(key: Key, name: &'static str, default: f32, min: f64, max: f64) -> Spec {
    Spec { key, name, default: Value::Float(default), min, max, writable: true }
}

const fn int(key: Key, name: &'static str, default: i32, min: i32, max: i32) -> Spec {
    let (min, max) = (min as f64, max as f64);
    Spec { key, name, default: Value::Int(default), min, max, writable: true }
}

/// A parameter that tells what the vehicle file says.
const fn fact(key: Key, name: &'static str, default: Value) -> Spec {
    Spec { key, name, default, min: f64::MIN, max: f64::MAX, writable: false }
}

/// Defaults are PX4's where PX4 has the parameter, except for the loss action (Land, since it
/// needs nothing but the vehicle) and COM_RC_OVERRIDE (sticks also end OFFBOARD: the pilot wins).
const TABLE: &[Spec] = &[
    // Cells in series.
    fact(Key::Bat1NCells, "BAT1_N_CELLS", Value::Int(0)),
    // Largest tilt at arming, rad. Own.
    float(Key::ComArmLevel, "COM_ARM_LEVEL", 0.3, 0.05, 1.5),
    // Disarm this long after landing, s; 0 or less: never.
    float(Key::ComDisarmLand, "COM_DISARM_LAND", 2.0, -1.0, 60.0),
    // Disarm if there is no take-off this long after arming, s; 0 or less: never.
    float(Key::ComDisarmPrflt, "COM_DISARM_PRFLT", 10.0, -1.0, 120.0),
    // Low battery: 0 warning only, 2 land, 3 return when critical, land when lower still.
    int(Key::ComLowBatAct, "COM_LOW_BAT_ACT", 0, 0, 3),
    // What follows the loss of the offboard stream: 0 position, 1 altitude, 2 stabilized (these
    // need sticks, else NAV_RCL_ACT), 3 return, 4 land, 5 hold, 6 terminate, 7 disarm.
    int(Key::ComOblRcAct, "COM_OBL_RC_ACT", 4, 0, 7),
    // The offboard stream is lost when the last setpoint is older than this, s.
    float(Key::ComOfLossT, "COM_OF_LOSS_T", 1.0, 0.0, 60.0),
    // 1: sticks over MAVLink; 4: none.
    int(Key::ComRcInMode, "COM_RC_IN_MODE", 1, 0, 4),
    // Sticks are lost when the last MANUAL_CONTROL is older than this, s.
    float(Key::ComRcLossT, "COM_RC_LOSS_T", 0.5, 0.0, 35.0),
    // Moved sticks take over to Position: bit 0 from automatic modes, bit 1 from OFFBOARD.
    int(Key::ComRcOverride, "COM_RC_OVERRIDE", 3, 0, 3),
    // Gains of the attitude loop, N m s/rad and N m/rad, its rate in Hz, and the sum of the
    // rotors' maximum thrust in N: what the vehicle file says. Own.
    fact(Key::DwKdPitch, "DW_KD_PITCH", Value::Float(0.0)),
    fact(Key::DwKdRoll, "DW_KD_ROLL", Value::Float(0.0)),
    fact(Key::DwKdYaw, "DW_KD_YAW", Value::Float(0.0)),
    fact(Key::DwKpPitch, "DW_KP_PITCH", Value::Float(0.0)),
    fact(Key::DwKpRoll, "DW_KP_ROLL", Value::Float(0.0)),
    fact(Key::DwKpYaw, "DW_KP_YAW", Value::Float(0.0)),
    fact(Key::DwPdRate, "DW_PD_RATE", Value::Float(0.0)),
    fact(Key::DwThrustMax, "DW_THRUST_MAX", Value::Float(0.0)),
    fact(Key::MavCompId, "MAV_COMP_ID", Value::Int(1)),
    // 0: MAVLink 1 until the peer speaks MAVLink 2.
    fact(Key::MavProtoVer, "MAV_PROTO_VER", Value::Int(0)),
    fact(Key::MavSysId, "MAV_SYS_ID", Value::Int(1)),
    fact(Key::MavType, "MAV_TYPE", Value::Int(2)),
    // Take-off height above the point of arming, m.
    float(Key::MisTakeoffAlt, "MIS_TAKEOFF_ALT", 2.5, 0.2, 80.0),
    // Speed of descent to the ground, m/s.
    float(Key::MpcLandSpeed, "MPC_LAND_SPEED", 0.7, 0.1, 2.0),
    // Collective output at hover, as the firmware believes. Not applied to offboard setpoints.
    float(Key::MpcThrHover, "MPC_THR_HOVER", 0.5, 0.05, 0.9),
    // Largest tilt in position control, degrees.
    float(Key::MpcTiltMaxAir, "MPC_TILTMAX_AIR", 35.0, 5.0, 60.0),
    // Climb speed of a take-off, m/s.
    float(Key::MpcTkoSpeed, "MPC_TKO_SPEED", 1.5, 0.2, 5.0),
    // Limits of position control, m/s.
    float(Key::MpcXyVelMax, "MPC_XY_VEL_MAX", 5.0, 0.2, 20.0),
    float(Key::MpcZVelMaxDn, "MPC_Z_VEL_MAX_DN", 1.5, 0.2, 4.0),
    float(Key::MpcZVelMaxUp, "MPC_Z_VEL_MAX_UP", 3.0, 0.2, 8.0),
    // Above 0, arming needs the heartbeat of a ground station.
    int(Key::NavDllAct, "NAV_DLL_ACT", 0, 0, 6),
    // What follows where sticks are needed and there are none: 1 hold, 2 return, 3 land,
    // 5 terminate, 6 disarm.
    int(Key::NavRclAct, "NAV_RCL_ACT", 2, 1, 6),
    fact(Key::SysAutostart, "SYS_AUTOSTART", Value::Int(4001)),
];

/// Keys are indices.
const _: () = {
    let mut index = 0;
    while index < TABLE.len() {
        assert!(TABLE[index].key as usize == index);
        index += 1;
    }
};

/// The values in force.
#[derive(Clone, Debug)]
pub struct Parameters {
    values: [Value; TABLE.len()],
}

impl Parameters {
    /// Number of parameters.
    pub const COUNT: usize = TABLE.len();

    /// Defaults, and what `vehicle` and its loop `pd` say.
    pub fn new(vehicle: &VehicleParams, pd: &AttitudePd) -> Self {
        let mut parameters = Self { values: std::array::from_fn(|index| TABLE[index].default) };
        let thrust_max: f64 = vehicle.rotors.iter().map(|rotor| rotor.thrust_max_n).sum();
        let facts = [
            (Key::MpcThrHover, vehicle.hover_thrust),
            (Key::DwThrustMax, thrust_max),
            (Key::DwPdRate, pd.rate_hz),
            (Key::DwKpRoll, pd.kp[0]),
            (Key::DwKpPitch, pd.kp[1]),
            (Key::DwKpYaw, pd.kp[2]),
            (Key::DwKdRoll, pd.kd[0]),
            (Key::DwKdPitch, pd.kd[1]),
            (Key::DwKdYaw, pd.kd[2]),
        ];
        for (key, value) in facts {
            parameters.values[key as usize] = Value::Float(value as f32);
        }
        parameters.values[Key::Bat1NCells as usize] = Value::Int(vehicle.battery.cells.into());
        parameters
    }

    /// The value of `key` as a number.
    #[inline]
    pub fn get(&self, key: Key) -> f64 {
        self.values[key as usize].as_f64()
    }

    /// A time in seconds, in microseconds; `None` where it is zero or less, which means never.
    pub fn timeout_us(&self, key: Key) -> Option<u64> {
        let seconds = self.get(key);
        (seconds > 0.0).then(|| (seconds * 1e6).round() as u64)
    }

    /// Index of `name`.
    pub fn find(&self, name: &str) -> Option<usize> {
        TABLE.iter().position(|spec| spec.name == name)
    }

    /// Name and value at `index`.
    pub fn at(&self, index: usize) -> Option<(&'static str, Value)> {
        Some((TABLE.get(index)?.name, *self.values.get(index)?))
    }

    /// Sets `name` and returns its index.
    ///
    /// # Errors
    /// [`SetError`]; the value in force stays.
    pub fn set(&mut self, name: &str, value: Value) -> Result<usize, SetError> {
        let index = self.find(name).ok_or(SetError::Unknown)?;
        let spec = &TABLE[index];
        if !spec.writable {
            return Err(SetError::ReadOnly);
        }
        if std::mem::discriminant(&value) != std::mem::discriminant(&spec.default) {
            return Err(SetError::Type);
        }
        // Also false for NaN.
        if !(spec.min..=spec.max).contains(&value.as_f64()) {
            return Err(SetError::Range { min: spec.min, max: spec.max });
        }
        self.values[index] = value;
        Ok(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing::parameters;

    #[test]
    fn names_and_defaults_fit() {
        for spec in TABLE {
            assert!(spec.name.len() <= 16, "{}", spec.name);
            assert!((spec.min..=spec.max).contains(&spec.default.as_f64()), "{}", spec.name);
        }
        assert!(TABLE.is_sorted_by_key(|spec| spec.name));
    }

    #[test]
    fn integers_are_byte_cast() {
        let (wire, kind) = Value::Int(5).to_wire();
        assert_eq!(kind, MavParamType::MAV_PARAM_TYPE_INT32);
        assert_eq!(wire, 7.0e-45);
        for value in [0, 4, -1, i32::MAX, i32::MIN] {
            let (wire, kind) = Value::Int(value).to_wire();
            assert_eq!(Value::from_wire(wire, kind), Some(Value::Int(value)));
        }
    }

    #[test]
    fn a_refused_value_leaves_the_old_one() {
        let mut parameters = parameters();
        let refusals = [
            ("COM_OF_LOSS_T", Value::Float(f32::NAN)),
            ("COM_OF_LOSS_T", Value::Float(-1.0)),
            ("COM_OF_LOSS_T", Value::Int(1)),
            ("COM_OBL_RC_ACT", Value::Int(8)),
            ("DW_KP_ROLL", Value::Float(1.0)),
            ("NO_SUCH_NAME", Value::Float(1.0)),
        ];
        for (name, value) in refusals {
            assert!(parameters.set(name, value).is_err(), "{name} {value:?}");
        }
        assert_eq!(parameters.get(Key::ComOfLossT), 1.0);
        parameters.set("COM_OF_LOSS_T", Value::Float(0.25)).unwrap();
        assert_eq!(parameters.timeout_us(Key::ComOfLossT), Some(250_000));
    }
}
