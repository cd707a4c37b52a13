//! What the catalogue says about an effect: its id, and its parameters with units and ranges.

use crate::params::VehicleParams;

/// Most numbers that one effect has; vectors count three.
pub const MAX_SLOTS: usize = 6;

/// An effect's numbers in the order of its [`Spec::parameters`], vectors laid out in place;
/// slots beyond [`Spec::slots`] are 0.
pub type Slots = [f64; MAX_SLOTS];

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

/// One effect of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Spec {
    /// Id in files and on the command line.
    pub id: &'static str,
    /// Parameters, in the order of the slots.
    pub parameters: &'static [Parameter],
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
    /// Every number of the effect, in order.
    pub fn slots(&self) -> impl Iterator<Item = Slot> + use<> {
        self.parameters
            .iter()
            .flat_map(|p| (0..p.kind.slots()).map(move |component| (p, component)))
            .enumerate()
            .map(|(index, (parameter, component))| Slot { index, parameter, component })
    }

    /// The first slot of the parameter `name`, and the parameter.
    pub fn find(&self, name: &str) -> Option<Slot> {
        self.slots().find(|slot| slot.parameter.name == name)
    }
}
