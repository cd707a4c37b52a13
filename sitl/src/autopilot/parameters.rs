//! Parameters: names, values, ranges, their encoding in the protocol's float, and their meaning to
//! the flight control.

use std::borrow::Cow;

use wire::dialect::MavParamType;

/// The meaning of a parameter to the flight control, named as in PX4. Each autopilot's table maps
/// its parameters and their units to keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the autopilots' tables describe each")]
pub enum Key {
    AngleBoost,
    BatCriticalVolt,
    BatCrtThr,
    BatLowThr,
    BatLowVolt,
    BatFsCrtAct,
    BatFsLowAct,
    ComArmLevel,
    ComDisarmLand,
    ComDisarmPrflt,
    ComDlLossT,
    ComFailActT,
    ComLowBatAct,
    ComOblRcAct,
    ComOfLossT,
    ComRcInMode,
    ComRcLossT,
    ComRcOverride,
    ComRclExcept,
    FsGcsEnable,
    GroundStationSystem,
    GuidOptions,
    InputTimeConstant,
    MisTakeoffAlt,
    MotPwmMax,
    MotPwmMin,
    MotSpinArm,
    MotSpinMax,
    MotSpinMin,
    MotSpoolTime,
    MpcLandSpeed,
    MpcThrHover,
    MpcTiltMaxAir,
    MpcTkoSpeed,
    MpcXyVelMax,
    MpcZVelMaxDn,
    MpcZVelMaxUp,
    NavDllAct,
    NavRclAct,
    PwmDisarmed,
    ThrustCurve,
    YawWeight,
}

/// Number of variants of [`Key`].
const KEYS: usize = Key::YawWeight as usize + 1;

/// A value with its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// INT32.
    Int(i32),
    /// REAL32.
    Float(f32),
}

impl Value {
    fn as_f64(self) -> f64 {
        match self {
            Self::Int(value) => value.into(),
            Self::Float(value) => value.into(),
        }
    }

    /// This value in the type of `other`.
    fn cast_as(self, other: Self) -> Self {
        match other {
            Self::Int(_) => Self::Int(self.as_f64().round() as i32),
            Self::Float(_) => Self::Float(self.as_f64() as f32),
        }
    }
}

/// Encoding of a parameter in the protocol's float.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cast {
    /// An integer's four bytes are reinterpreted, not converted: 5 reads as 7.0e-45. A value of a
    /// different type is refused (PX4).
    Bytes,
    /// Integers are converted, and values of either type are accepted (ArduPilot).
    Number,
}

impl Cast {
    /// Encodes a value as the protocol's float and type.
    pub fn to_wire(self, value: Value) -> (f32, MavParamType) {
        match (value, self) {
            (Value::Float(value), _) => (value, MavParamType::MAV_PARAM_TYPE_REAL32),
            (Value::Int(value), Self::Bytes) => {
                (f32::from_bits(value.cast_unsigned()), MavParamType::MAV_PARAM_TYPE_INT32)
            }
            (Value::Int(value), Self::Number) => (value as f32, MavParamType::MAV_PARAM_TYPE_INT32),
        }
    }

    /// Decodes a value, the inverse of [`Cast::to_wire`]; `None` for an unsupported type.
    pub fn from_wire(self, value: f32, kind: MavParamType) -> Option<Value> {
        match (kind, self) {
            (_, Self::Number) => Some(Value::Float(value)),
            (MavParamType::MAV_PARAM_TYPE_INT32, Self::Bytes) => {
                Some(Value::Int(value.to_bits().cast_signed()))
            }
            (MavParamType::MAV_PARAM_TYPE_REAL32, Self::Bytes) => Some(Value::Float(value)),
            _ => None,
        }
    }
}

/// Why a parameter cannot be set.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetError {
    /// There is no parameter with this name.
    #[error("no parameter of this name")]
    Unknown,
    /// The type on the wire differs from the parameter's.
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
    /// The parameter reflects the vehicle file and cannot be set.
    #[error("read only")]
    ReadOnly,
}

/// One parameter of an autopilot.
#[derive(Clone, Debug)]
pub struct Spec {
    key: Option<Key>,
    /// Factor from the parameter's unit to the key's.
    scale: f64,
    name: Cow<'static, str>,
    default: Value,
    min: f64,
    max: f64,
    writable: bool,
}

impl Spec {
    /// The parameter's name on the wire.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Sets the factor from the parameter's unit to the key's.
    pub const fn scaled(mut self, scale: f64) -> Self {
        self.scale = scale;
        self
    }
}

/// A real parameter that affects the vehicle.
pub const fn float(key: Key, name: &'static str, default: f32, min: f64, max: f64) -> Spec {
    heeded(key, name, Value::Float(default), [min, max])
}

/// An integer parameter that affects the vehicle.
pub const fn int(key: Key, name: &'static str, default: i32, min: i32, max: i32) -> Spec {
    heeded(key, name, Value::Int(default), [min as f64, max as f64])
}

const fn heeded(key: Key, name: &'static str, default: Value, [min, max]: [f64; 2]) -> Spec {
    Spec {
        key: Some(key),
        scale: 1.0,
        name: Cow::Borrowed(name),
        default,
        min,
        max,
        writable: true,
    }
}

/// A read-only parameter that reports a built-in value.
pub fn fact(name: impl Into<Cow<'static, str>>, value: Value) -> Spec {
    let (min, max) = (f64::MIN, f64::MAX);
    Spec { key: None, scale: 1.0, name: name.into(), default: value, min, max, writable: false }
}

/// A writable real parameter that the attitude loop looks up by name.
pub fn gain(name: impl Into<Cow<'static, str>>, value: f64) -> Spec {
    Spec { writable: true, ..fact(name, Value::Float(value as f32)) }
}

/// The parameters with their present values.
#[derive(Clone, Debug)]
pub struct Parameters {
    specs: Vec<Spec>,
    values: Vec<Value>,
    by_key: [Option<usize>; KEYS],
    built_in: [f64; KEYS],
    cast: Cast,
}

impl Parameters {
    /// Creates parameters with the defaults of `specs`, in the order of their wire indices.
    /// `built_in` gives values for keys without a parameter; a key without either is 0.
    pub fn new(specs: Vec<Spec>, built_in: &[(Key, f64)], cast: Cast) -> Self {
        let mut parameters = Self {
            values: specs.iter().map(|spec| spec.default).collect(),
            by_key: [None; KEYS],
            built_in: [0.0; KEYS],
            cast,
            specs,
        };
        for (index, spec) in parameters.specs.iter().enumerate() {
            if let Some(key) = spec.key {
                parameters.by_key[key as usize] = Some(index);
            }
        }
        for (key, value) in built_in {
            parameters.built_in[*key as usize] = *value;
        }
        parameters
    }

    /// Number of parameters.
    pub fn count(&self) -> usize {
        self.specs.len()
    }

    /// The value of `key` in the key's unit.
    #[inline]
    pub fn get(&self, key: Key) -> f64 {
        match self.by_key[key as usize] {
            Some(index) => self.values[index].as_f64() * self.specs[index].scale,
            None => self.built_in[key as usize],
        }
    }

    /// A time parameter in microseconds; `None` if it is zero or negative, which means never.
    pub fn timeout_us(&self, key: Key) -> Option<u64> {
        let seconds = self.get(key);
        (seconds > 0.0).then(|| (seconds * 1e6).round() as u64)
    }

    /// The value of `name`, in the parameter's unit.
    pub fn named(&self, name: &str) -> Option<f64> {
        Some(self.values[self.find(name)?].as_f64())
    }

    /// Wire index of `name`.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.specs.iter().position(|spec| spec.name == name)
    }

    /// Name, encoded value and type of the parameter at `index`.
    pub fn at(&self, index: usize) -> Option<(&str, f32, MavParamType)> {
        let (wire, kind) = self.cast.to_wire(*self.values.get(index)?);
        Some((&self.specs.get(index)?.name, wire, kind))
    }

    /// Sets `name` to a value from the wire and returns its index.
    ///
    /// # Errors
    /// [`SetError`]; the value stays unchanged.
    pub fn set_from_wire(
        &mut self,
        name: &str,
        value: f32,
        kind: MavParamType,
    ) -> Result<usize, SetError> {
        self.set(name, self.cast.from_wire(value, kind).ok_or(SetError::Type)?)
    }

    /// Sets `name` to a number, converted to the parameter's type.
    ///
    /// # Errors
    /// [`SetError`]; the value stays unchanged.
    pub fn set_number(&mut self, name: &str, value: f64) -> Result<usize, SetError> {
        let index = self.find(name).ok_or(SetError::Unknown)?;
        let value = Value::Float(value as f32).cast_as(self.specs[index].default);
        self.set(name, value)
    }

    /// Sets `name` and returns its index.
    ///
    /// # Errors
    /// [`SetError`]; the value stays unchanged.
    pub fn set(&mut self, name: &str, value: Value) -> Result<usize, SetError> {
        let index = self.find(name).ok_or(SetError::Unknown)?;
        let spec = &self.specs[index];
        if !spec.writable {
            return Err(SetError::ReadOnly);
        }
        let same_type = std::mem::discriminant(&value) == std::mem::discriminant(&spec.default);
        if self.cast == Cast::Bytes && !same_type {
            return Err(SetError::Type);
        }
        // Also false for NaN.
        if !(spec.min..=spec.max).contains(&value.as_f64()) {
            return Err(SetError::Range { min: spec.min, max: spec.max });
        }
        self.values[index] = value.cast_as(spec.default);
        Ok(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing::parameters;

    #[test]
    fn integers_are_byte_cast() {
        let (wire, kind) = Cast::Bytes.to_wire(Value::Int(5));
        assert_eq!(kind, MavParamType::MAV_PARAM_TYPE_INT32);
        assert_eq!(wire, 7.0e-45);
        for value in [0, 4, -1, i32::MAX, i32::MIN] {
            let (wire, kind) = Cast::Bytes.to_wire(Value::Int(value));
            assert_eq!(Cast::Bytes.from_wire(wire, kind), Some(Value::Int(value)));
        }
    }

    #[test]
    fn refused_value_keeps_the_old_one() {
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
