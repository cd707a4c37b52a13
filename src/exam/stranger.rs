//! What the catalogue does not have, with a direction and a size: disturbances from outside, and
//! other laws for causes that it knows.

use std::f64::consts::TAU;

use sitl::effects::EffectId;
use sitl::foreign::Foreign;
use sitl::vehicle::{ROTORS, VehicleParams};

use super::draw::{Draw, rounded};

/// A foreign thing at size 1: as much as a vehicle may sensibly meet.
#[derive(Clone, Debug)]
pub struct Stranger {
    full: Foreign,
    /// The effects whose cause it is; none of a disturbance from outside.
    pub causes: &'static [EffectId],
}

/// Share of the thrust that an exponential ground effect adds on the floor at size 1: a rotor half
/// a radius above it gains a third (Cheeseman and Bennett 1955), four side by side more.
const GROUND_GAIN: f64 = 0.6;
/// Kinds of disturbances from outside.
const DISTURBANCES: usize = 7;
/// Kinds of other laws without a modelled drag, and how many of them are drags.
const LAWS: usize = 7;
const DRAGS: usize = 2;

impl Stranger {
    /// A disturbance from outside.
    pub fn disturbance(draw: &mut Draw, vehicle: &VehicleParams) -> Self {
        let weight = vehicle.mass * vehicle.gravity;
        let push = |draw: &mut Draw, share: f64| -> [f64; 3] {
            let direction = draw.within([0.0, TAU]);
            let steep = draw.within([-0.5, 0.5]);
            [direction.cos(), direction.sin(), steep].map(|part| rounded(share * weight * part))
        };
        let full = match draw.below(DISTURBANCES) {
            0 => Foreign::SlungLoad {
                mass_kg: 0.5 * vehicle.mass,
                length_m: rounded(draw.within([0.3, 1.2])),
                damping: rounded(draw.within([0.02, 0.1])),
            },
            1 => {
                let length = draw.within([0.5, 1.5]);
                Foreign::Tether {
                    anchor_m: [
                        rounded(draw.within([-2.0, 2.0])),
                        rounded(draw.within([-2.0, 2.0])),
                        0.0,
                    ],
                    slack_m: rounded(length),
                    stiffness_n_m: rounded(0.3 * weight),
                }
            }
            2 => Foreign::Periodic {
                force_n: push(draw, 0.4),
                period_s: rounded(draw.log_within([0.7, 4.0])),
            },
            3 => Foreign::Jet {
                centre_m: [rounded(draw.within([-1.0, 1.0])), rounded(draw.within([-1.0, 1.0]))],
                radius_m: rounded(draw.within([0.5, 1.2])),
                force_n: push(draw, 0.6),
            },
            4 => Foreign::Bumps {
                force_n: rounded(1.0 * weight),
                duration_s: rounded(draw.within([0.1, 0.3])),
                interval_s: rounded(draw.within([1.0, 3.0])),
            },
            5 => Foreign::ThrustBursts {
                rotor: draw.below(ROTORS),
                loss: 0.4,
                duration_s: rounded(draw.within([0.2, 0.8])),
                interval_s: rounded(draw.within([1.0, 3.0])),
            },
            _ => Foreign::YawRateForce { force_ns: rounded(draw.sign() * 0.3 * weight) },
        };
        Self { full, causes: &[] }
    }

    /// Another law for a cause that the catalogue has. Wind needs a drag in the vehicle file;
    /// beside that drag no other is drawn.
    pub fn law(draw: &mut Draw, vehicle: &VehicleParams, has_drag: bool) -> Self {
        use EffectId::*;
        let weight = vehicle.mass * vehicle.gravity;
        let number = if has_drag { DRAGS + draw.below(LAWS + 1 - DRAGS) } else { draw.below(LAWS) };
        let (full, causes): (Foreign, &[EffectId]) = match number {
            0 => {
                let exponent = rounded(draw.within([1.3, 1.7]));
                let coefficient = rounded(0.6 * weight / 8.0_f64.powf(exponent));
                (Foreign::DragPower { coefficient, exponent }, &[RotorDrag, ParasiticDrag])
            }
            1 => {
                let quadratic = 0.6 * weight / 64.0;
                let full = Foreign::DragBody {
                    quadratic: [1.0, draw.within([0.8, 1.2]), draw.within([1.0, 2.0])]
                        .map(|share| rounded(share * quadratic)),
                    cross: rounded(draw.within([-0.2, 0.2]) * quadratic),
                };
                (full, &[ParasiticDrag, RotorDrag])
            }
            2 => (Foreign::LagSecondOrder { tau_s: 0.035 }, &[MotorLag]),
            3 => {
                let up_s = 0.05;
                let down_s = rounded(up_s * draw.within([1.4, 2.0]));
                (Foreign::LagAsymmetric { up_s, down_s }, &[MotorLag])
            }
            4 => {
                let length = vehicle.rotor_radius_m * draw.within([1.5, 3.0]);
                (
                    Foreign::GroundExponential { gain: GROUND_GAIN, length_m: rounded(length) },
                    &[GroundEffect],
                )
            }
            5 => {
                let recovery_s = rounded(draw.within([1.0, 4.0]));
                (Foreign::SagRecovery { exponent: 2.5, recovery_s }, &[BatterySag])
            }
            6 => (Foreign::CurveCubic { b: 0.5 }, &[ThrustCurve]),
            _ => {
                let direction = draw.within([0.0, TAU]);
                let full = Foreign::WindShear {
                    velocity_m_s: [direction.cos(), direction.sin()].map(|c| rounded(8.0 * c)),
                    exponent: rounded(draw.within([0.1, 0.25])),
                };
                (full, &[Wind])
            }
        };
        Self { full, causes }
    }

    /// The thing at a size.
    pub fn at(&self, size: f64) -> Foreign {
        let by = |value: f64| rounded(size * value);
        let mut sized = self.full.clone();
        match &mut sized {
            Foreign::SlungLoad { mass_kg: value, .. }
            | Foreign::Tether { stiffness_n_m: value, .. }
            | Foreign::Bumps { force_n: value, .. }
            | Foreign::ThrustBursts { loss: value, .. }
            | Foreign::YawRateForce { force_ns: value }
            | Foreign::DragPower { coefficient: value, .. }
            | Foreign::LagSecondOrder { tau_s: value }
            | Foreign::GroundExponential { gain: value, .. }
            | Foreign::SagRecovery { exponent: value, .. }
            | Foreign::CurveCubic { b: value } => *value = by(*value),
            Foreign::Periodic { force_n: values, .. } | Foreign::Jet { force_n: values, .. } => {
                *values = values.map(by);
            }
            Foreign::DragBody { quadratic, cross } => {
                *quadratic = quadratic.map(by);
                *cross = by(*cross);
            }
            Foreign::LagAsymmetric { up_s, down_s } => {
                (*up_s, *down_s) = (by(*up_s), by(*down_s));
            }
            Foreign::WindShear { velocity_m_s, .. } => *velocity_m_s = velocity_m_s.map(by),
        }
        sized
    }
}
