//! Orders for cases: what to fly.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::VehicleParams;
use vehicle::effects::EffectId;

use super::condition::Condition;
use super::world::World;

/// The kind of question that a case asks.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    JsonSchema,
    Serialize,
    Deserialize,
    clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// No effect beyond noise and tolerances.
    Null,
    /// One effect of the catalogue.
    Single,
    /// Two effects of the catalogue.
    Pair,
    /// An effect that the vehicle file models with wrong values, or that needs a modelled one.
    Modelled,
    /// One effect, diagnosed with a catalogue that lacks it.
    LeftOut,
    /// A disturbance from outside that matches no effect of the catalogue.
    Foreign,
    /// A cause of the catalogue under another law.
    OtherLaw,
    /// One effect on flights that confuse it with another or do not show it.
    Trap,
    /// One effect on a shipped vehicle, at one of three strengths, with logs in one condition.
    #[value(skip)]
    RoundTrip,
}

impl Kind {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::Single => "single",
            Self::Pair => "pair",
            Self::Modelled => "modelled",
            Self::LeftOut => "left-out",
            Self::Foreign => "foreign",
            Self::OtherLaw => "other-law",
            Self::Trap => "trap",
            Self::RoundTrip => "round-trip",
        }
    }

    /// Whether its flights hide or confuse the effect.
    pub fn is_trap(self) -> bool {
        self == Self::Trap
    }

    /// Every kind except nulls, with its share of the cases.
    pub const SHARES: [(Kind, f64); 7] = [
        (Kind::Single, 0.4),
        (Kind::Pair, 0.12),
        (Kind::Modelled, 0.08),
        (Kind::LeftOut, 0.12),
        (Kind::Foreign, 0.1),
        (Kind::OtherLaw, 0.1),
        (Kind::Trap, 0.08),
    ];
}

/// An order for one case.
#[derive(Clone, Debug)]
pub struct Order {
    /// The kind of question.
    pub kind: Kind,
    /// The parameters of a round trip.
    pub round_trip: Option<RoundTrip>,
}

impl From<Kind> for Order {
    fn from(kind: Kind) -> Self {
        Self { kind, round_trip: None }
    }
}

/// A case of the round trip.
#[derive(Clone, Debug)]
pub struct RoundTrip {
    /// The vehicle; the case replaces its name.
    pub vehicle: VehicleParams,
    /// The effect that it has.
    pub effect: EffectId,
    /// The wanted ratio over noise.
    pub ratio: f64,
    /// Condition of its logs.
    pub condition: Condition,
}

impl RoundTrip {
    /// Ratios over noise in a round trip.
    pub const RATIOS: [f64; 3] = [3.0, 6.0, 12.0];

    /// Every effect of the catalogue at every strength on every vehicle with logs in every
    /// condition.
    pub fn all(vehicles: &[VehicleParams]) -> Vec<Order> {
        let mut orders = Vec::new();
        for vehicle in vehicles {
            for effect in EffectId::ALL {
                for ratio in Self::RATIOS {
                    for condition in Condition::ALL {
                        let vehicle = vehicle.clone();
                        let trip = Self { vehicle, effect, ratio, condition };
                        orders.push(Order { kind: Kind::RoundTrip, round_trip: Some(trip) });
                    }
                }
            }
        }
        orders
    }
}

/// Settings that all cases share.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Flights per case.
    pub flights: usize,
    /// Length of a log, s.
    pub seconds: f64,
    /// Range of ratios over noise of single effects, with exact files.
    pub ratios: [f64; 2],
    /// The kind of vehicles.
    pub world: World,
}

impl Default for Settings {
    fn default() -> Self {
        Self { flights: 4, seconds: 22.5, ratios: [0.3, 30.0], world: World::Exact }
    }
}
