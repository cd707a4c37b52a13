//! What the catalogue says about an effect: its id, and its parameters with units and ranges.

use super::EffectId;
use crate::params::VehicleParams;

/// Most numbers that one effect has; vectors count three.
pub const MAX_SLOTS: usize = 6;

/// An effect's numbers in the order of its [`Spec::parameters`], vectors laid out in place;
/// slots beyond [`Spec::slots`] are 0.
pub type Slots = [f64; MAX_SLOTS];

/// The first slots, and zeros.
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
    /// Three real numbers, in the axes' order.
    Vec3,
    /// A whole number from 0, as a rotor's place in the vehicle file.
    Index,
}

impl Kind {
    /// How many numbers it takes.
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
    /// The same for every vehicle; also the default of a parameter that is not given.
    Value(f64),
    /// A number of the vehicle file. The parameter must be given.
    Vehicle(fn(&VehicleParams) -> f64),
    /// No value of this parameter means "no effect", as for a rotor's index. It must be given.
    None,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// Unit; "-" where there is none.
    pub unit: &'static str,
    /// Shape.
    pub kind: Kind,
    /// The value that means "no effect".
    pub neutral: Neutral,
    /// Value taken when the parameter is not given; `None` where it must be.
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

    /// A real number whose neutral value is the vehicle file's; it must be given.
    pub const fn of_vehicle(
        name: &'static str,
        unit: &'static str,
        neutral: fn(&VehicleParams) -> f64,
        range: [f64; 2],
    ) -> Self {
        let parameter = Self::scalar(name, unit, 0.0, range);
        Self { neutral: Neutral::Vehicle(neutral), default: None, ..parameter }
    }

    /// A place in a list of `count`; it must be given.
    pub const fn index(name: &'static str, count: usize) -> Self {
        let parameter = Self::scalar(name, "-", 0.0, [0.0, (count - 1) as f64]);
        Self { kind: Kind::Index, neutral: Neutral::None, default: None, ..parameter }
    }

    /// The same parameter, without a neutral value of its own: it only shapes the effect that
    /// another parameter switches on.
    pub const fn shape(self) -> Self {
        Self { neutral: Neutral::None, ..self }
    }
}

/// What a log must hold to show an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Something that was commanded: setpoints, motor outputs or rotor speeds.
    Input,
    /// Pose or accelerometer.
    Motion,
    /// Position, velocity and attitude.
    Pose,
    /// Attitude, and velocity or body rate beside it.
    Attitude,
    /// Attitude or body rate, and what each rotor did.
    Moment,
    /// Motor outputs, where these are what drives, no slower than the rotors.
    FastOutputs,
    /// Setpoints, or else fast outputs.
    FastInput,
    /// A voltage that changes.
    Voltage,
    /// An IMU that is faster than the estimate.
    Imu,
    /// Setpoints with attitude, rates and thrust.
    WholeSetpoint,
}

/// How an effect grows from nothing to as much as a vehicle may sensibly have: its slots are `from`
/// at size 0 and `from` + `by` at size 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct Growth {
    /// At size 0: what the vehicle file says, where nothing else is set.
    pub from: Slots,
    /// What size 1 adds.
    pub by: Slots,
}

/// Where the direction of an effect is drawn from.
pub trait Chance {
    /// Evenly within a range.
    fn within(&mut self, range: [f64; 2]) -> f64;

    /// Either sign.
    fn sign(&mut self) -> f64;

    /// A whole number below `count`, which is at least 1.
    fn below(&mut self, count: usize) -> usize;

    /// Evenly in the logarithm within a range of positive numbers.
    fn log_within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.within([low.ln(), high.ln()]).exp()
    }

    /// What to add to a factor of 1: more by a share within a range, or less by it, down to 0.6.
    fn scale(&mut self, range: [f64; 2]) -> f64 {
        (self.sign() * self.within(range)).max(-0.4)
    }

    /// A direction in a plane, as a unit vector.
    fn heading(&mut self) -> [f64; 2] {
        let (sin, cos) = self.within([0.0, std::f64::consts::TAU]).sin_cos();
        [cos, sin]
    }
}

/// One effect of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Spec {
    /// Id in files and on the command line.
    pub id: &'static str,
    /// Parameters, in the order of the slots.
    pub parameters: &'static [Parameter],
    /// What a log must hold to show it, the first first.
    pub needs: &'static [Need],
    /// Typical sizes of its slots where it occurs, beyond what the vehicle file says: the widths of
    /// a diagnosis' priors. A slot of size 0 is not fitted.
    pub typical: fn(&VehicleParams) -> Slots,
    /// Draws how it grows to as much as a vehicle may sensibly have: what an exam makes of it.
    pub strong: fn(&VehicleParams, &mut dyn Chance, &mut Growth),
    /// The effect that it is a variant of, or that no flight tells from it: it is reported as that
    /// one.
    pub family: Option<EffectId>,
    /// Whether it grows with the square of its first slot, so that at 0 there is no slope.
    pub is_quadratic: bool,
    /// Parameters that an answer is judged by, those of one group as one vector; none for each that
    /// has a neutral value by itself.
    pub judged: &'static [&'static [&'static str]],
}

/// One number of an effect: a parameter, or one component of a vector.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// Place in [`Slots`].
    pub index: usize,
    /// The parameter that it belongs to.
    pub parameter: &'static Parameter,
    /// Which component; 0 for a scalar.
    pub component: usize,
}

impl Spec {
    /// Without a name, and of no size.
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

    /// The parameters that an answer is judged by, those of one group as one vector.
    pub fn judged(&self) -> Vec<Vec<&'static str>> {
        if !self.judged.is_empty() {
            return self.judged.iter().map(|group| group.to_vec()).collect();
        }
        let has_neutral = |p: &&Parameter| !matches!(p.neutral, Neutral::None);
        self.parameters.iter().filter(has_neutral).map(|p| vec![p.name]).collect()
    }

    /// The first slot of the parameter `name`, and the parameter.
    pub fn find(&self, name: &str) -> Option<Slot> {
        self.slots().find(|slot| slot.parameter.name == name)
    }
}
