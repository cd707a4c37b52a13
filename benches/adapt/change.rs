//! Changes in flight.

use sitl::autopilot::Vehicle;
use vehicle::foreign::Foreign;

use crate::flight::Draw;

/// Added fraction of the vehicle's mass.
const PAYLOAD: f64 = 0.3;
/// Gust speed, m/s.
const GUST: f64 = 5.0;
/// Lost fraction of one rotor's thrust and torque.
const WEAR: f64 = 0.25;
/// Charge to which the pack drops at once, and dependence of thrust on its voltage.
const CHARGE: f64 = 0.35;
const SAG_SLOPE: f64 = 1.5;
const SAG_S: f64 = 1.5;
/// Dead zone and exponent of the thrust map.
const DEAD: f64 = 0.05;
const POWER: f64 = 1.15;

/// A change without any announcement to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    None,
    Payload,
    Gust,
    Rotor,
    Sag,
    Map,
}

impl Change {
    pub const ALL: [Self; 6] =
        [Self::None, Self::Payload, Self::Gust, Self::Rotor, Self::Sag, Self::Map];

    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Payload => "payload",
            Self::Gust => "gust",
            Self::Rotor => "rotor",
            Self::Sag => "sag",
            Self::Map => "map",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|change| change.name() == name)
    }

    /// Applies the change.
    pub fn act(self, vehicle: &mut Vehicle, draw: &Draw) {
        let (sin, cos) = draw.direction_rad.sin_cos();
        let foreign = match self {
            Self::None => return,
            Self::Payload => Foreign::Payload { share: PAYLOAD },
            Self::Gust => {
                Foreign::WindShear { velocity_m_s: [GUST * cos, GUST * sin], exponent: 0.0 }
            }
            Self::Rotor => Foreign::RotorWear { rotor: draw.rotor, loss: WEAR, torque_share: 1.0 },
            Self::Sag => {
                vehicle.drain(CHARGE);
                Foreign::SagAffine { slope: SAG_SLOPE, recovery_s: SAG_S }
            }
            Self::Map => Foreign::CurvePower { dead: DEAD, power: POWER },
        };
        vehicle.disturb(foreign, draw.seed);
    }
}
