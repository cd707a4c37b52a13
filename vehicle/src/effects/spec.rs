//! A catalogue entry: an effect's id, its parameters with units and ranges, and its typical size.

use super::EffectId;
use crate::params::VehicleParams;

/// Largest number of slots of an effect; a vector takes three.
pub const MAX_SLOTS: usize = 6;

/// An effect's numbers in the order of its [`Spec::parameters`], vectors laid out in place;
/// slots beyond [`Spec::slots`] are 0.
pub type Slots = [f64; MAX_SLOTS];

/// Fills the first slots with `values` and the rest with zeros.
pub const fn slots<const N: usize>(values: [f64; N]) -> Slots {
    let mut slots = [0.0; MAX_SLOTS];
    let mut index = 0;
    while index < N {
        slots[index] = values[index];
        index += 1;
    }
    slots
}

/// Shape of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One real number.
    Scalar,
    /// Three real numbers, about or along body x, y, z.
    Vec3,
    /// A whole number from 0, such as a rotor's index in the vehicle file.
    Index,
}

impl Kind {
    /// Number of slots that the parameter takes.
    pub const fn slots(self) -> usize {
        match self {
            Kind::Scalar | Kind::Index => 1,
            Kind::Vec3 => 3,
        }
    }
}

/// The value that means "no effect".
#[derive(Clone, Copy, Debug)]
pub enum Neutral {
    /// The same value for every vehicle.
    Value(f64),
    /// A number of the vehicle file. The parameter has no default.
    Vehicle(fn(&VehicleParams) -> f64),
    /// No value of this parameter means "no effect": a rotor's index, or a shape parameter.
    None,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// Unit; "-" for a dimensionless parameter.
    pub unit: &'static str,
    /// Whether the parameter is a scalar, a vector or an index.
    pub kind: Kind,
    /// The value that means "no effect".
    pub neutral: Neutral,
    /// Value of a parameter that is not given; `None` if it is required.
    pub default: Option<f64>,
    /// Least accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
}

impl Parameter {
    /// A real number whose default is its neutral value.
    pub const fn scalar(
        name: &'static str,
        unit: &'static str,
        neutral: f64,
        range: [f64; 2],
    ) -> Self {
        Self {
            name,
            unit,
            kind: Kind::Scalar,
            neutral: Neutral::Value(neutral),
            default: Some(neutral),
            min: range[0],
            max: range[1],
        }
    }

    /// Three real numbers whose defaults are their neutral value.
    pub const fn vec3(
        name: &'static str,
        unit: &'static str,
        neutral: f64,
        range: [f64; 2],
    ) -> Self {
        Self { kind: Kind::Vec3, ..Self::scalar(name, unit, neutral, range) }
    }

    /// A required real number whose neutral value comes from the vehicle file.
    pub const fn of_vehicle(
        name: &'static str,
        unit: &'static str,
        neutral: fn(&VehicleParams) -> f64,
        range: [f64; 2],
    ) -> Self {
        let parameter = Self::scalar(name, unit, 0.0, range);
        Self { neutral: Neutral::Vehicle(neutral), default: None, ..parameter }
    }

    /// A required index into a list of `count`.
    pub const fn index(name: &'static str, count: usize) -> Self {
        let parameter = Self::scalar(name, "-", 0.0, [0.0, (count - 1) as f64]);
        Self { kind: Kind::Index, neutral: Neutral::None, default: None, ..parameter }
    }

    /// Removes the parameter's neutral value: it only shapes an effect that another parameter
    /// switches on.
    pub const fn shape(self) -> Self {
        Self { neutral: Neutral::None, ..self }
    }
}

/// What a log must contain to show an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Commands: setpoints, motor outputs or rotor speeds.
    Input,
    /// Pose or accelerometer.
    Motion,
    /// Position, velocity and attitude.
    Pose,
    /// Attitude, and velocity or body rate.
    Attitude,
    /// Attitude or body rate, and the output or speed of each rotor.
    Moment,
    /// Motor outputs at least as fast as the rotors' lag. Needed only where outputs, not setpoints,
    /// drive the model.
    FastOutputs,
    /// Setpoints, or fast motor outputs.
    FastInput,
    /// A battery voltage that varies.
    Voltage,
    /// An IMU that is faster than the estimate.
    Imu,
    /// Setpoints with attitude, rates and thrust.
    WholeSetpoint,
}

/// How an effect grows from nothing to the largest plausible size: its slots are `from` at size 0
/// and `from` + `by` at size 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct Growth {
    /// Slots at size 0: the vehicle file's values, unless set otherwise.
    pub from: Slots,
    /// What size 1 adds.
    pub by: Slots,
}

/// A source of random directions and signs for an effect.
pub trait Chance {
    /// Uniform within a range.
    fn within(&mut self, range: [f64; 2]) -> f64;

    /// 1 or -1.
    fn sign(&mut self) -> f64;

    /// A whole number below `count`, which is at least 1.
    fn below(&mut self, count: usize) -> usize;

    /// Log-uniform within a range of positive numbers.
    fn log_within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.within([low.ln(), high.ln()]).exp()
    }

    /// What to add to a factor of 1: plus or minus a share drawn from `range`, at least -0.4.
    fn scale(&mut self, range: [f64; 2]) -> f64 {
        (self.sign() * self.within(range)).max(-0.4)
    }

    /// A uniform direction in a plane, as a unit vector.
    fn heading(&mut self) -> [f64; 2] {
        let (sin, cos) = self.within([0.0, std::f64::consts::TAU]).sin_cos();
        [cos, sin]
    }
}

/// An effect's entry in the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Spec {
    /// Id in files and on the command line.
    pub id: &'static str,
    /// Parameters, in the order of the slots.
    pub parameters: &'static [Parameter],
    /// What a log must contain to show the effect, most basic need first.
    pub needs: &'static [Need],
    /// Typical deviation of each slot from the vehicle file where the effect occurs: the widths of
    /// the diagnosis' priors. A slot of size 0 is not fitted.
    pub typical: fn(&VehicleParams) -> Slots,
    /// Draws the growth to the largest plausible size, for the exam.
    pub strong: fn(&VehicleParams, &mut dyn Chance, &mut Growth),
    /// The effect under which a diagnosis reports this one: one that it is a variant of, or that no
    /// flight can distinguish from it.
    pub family: Option<EffectId>,
    /// Whether the effect grows with the square of its first slot and has no slope at 0.
    pub is_quadratic: bool,
    /// Parameters by which the exam judges an answer; each group counts as one vector. If it is empty,
    /// the exam judges each parameter that has a neutral value separately.
    pub judged: &'static [&'static [&'static str]],
}

/// One number of an effect: a parameter, or one component of a vector.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// Index in [`Slots`].
    pub index: usize,
    /// The parameter that the number belongs to.
    pub parameter: &'static Parameter,
    /// Component of a vector; 0 for a scalar.
    pub component: usize,
}

impl Spec {
    /// Defaults for the fields of a specification: no name, no parameters, size 0.
    pub const PLAIN: Self = Self {
        id: "",
        parameters: &[],
        needs: &[],
        typical: |_| [0.0; MAX_SLOTS],
        strong: |_, _, _| {},
        family: None,
        is_quadratic: false,
        judged: &[],
    };

    /// Every number of the effect, in order.
    pub fn slots(&self) -> impl Iterator<Item = Slot> + use<> {
        self.parameters
            .iter()
            .flat_map(|p| (0..p.kind.slots()).map(move |component| (p, component)))
            .enumerate()
            .map(|(index, (parameter, component))| Slot { index, parameter, component })
    }

    /// The groups of parameters by which the exam judges an answer; each group counts as one
    /// vector.
    pub fn judged(&self) -> Vec<Vec<&'static str>> {
        if !self.judged.is_empty() {
            return self.judged.iter().map(|group| group.to_vec()).collect();
        }
        let has_neutral = |p: &&Parameter| !matches!(p.neutral, Neutral::None);
        self.parameters.iter().filter(has_neutral).map(|p| vec![p.name]).collect()
    }

    /// The first slot of the parameter `name`.
    pub fn find(&self, name: &str) -> Option<Slot> {
        self.slots().find(|slot| slot.parameter.name == name)
    }
}
