//! Truths outside the catalogue, with a direction and a size: disturbances from outside, and other
//! laws for known causes.

use std::f64::consts::TAU;

use vehicle::effects::{EffectId, EffectSet, Slots};
use vehicle::foreign::Foreign;
use vehicle::{ROTORS, VehicleParams};

use super::airframe;
use super::draw::{Draw, rounded};

/// A truth outside the catalogue; size 1 is the largest that a vehicle may sensibly meet.
#[derive(Clone, Debug)]
pub struct ForeignDirection {
    full: Foreign,
    /// The part that the catalogue can describe, at size 1.
    beside: Option<Payload>,
    /// Lag of the rotors in the vehicle file, s.
    lag_s: f64,
    /// Effects of the catalogue with the same cause; empty for a disturbance from outside.
    pub causes: &'static [EffectId],
}

/// A payload at size 1.
#[derive(Clone, Copy, Debug)]
struct Payload {
    /// Mass of the vehicle without the payload, kg.
    vehicle_kg: f64,
    /// Mass of the payload, as a share of the vehicle's.
    share: f64,
    /// Increase of the moments of inertia about roll and pitch, as a share.
    inertia: f64,
}

/// Share of the thrust that an exponential ground effect adds on the floor at size 1: a rotor half
/// a radius above it gains a third (Cheeseman and Bennett 1955), four side by side more.
const GROUND_GAIN: f64 = 0.6;
/// Number of kinds of disturbances from outside.
const DISTURBANCES: usize = 7;
/// Number of kinds of other laws without a modelled drag, and how many of them are drags.
const LAWS: usize = 15;
const DRAGS: usize = 3;
/// Number of further kinds with a modelled drag: winds.
const WINDS: usize = 2;
/// Lag added at size 1, s.
const LAG_S: f64 = 0.06;
/// A payload at size 1: its mass relative to the vehicle's, its distance below in arms, and the
/// increase of the inertia.
const PAYLOAD: f64 = 0.2;
const PAYLOAD_BELOW: f64 = 0.3;
const PAYLOAD_INERTIA: f64 = 0.07;

impl ForeignDirection {
    /// Draws a disturbance from outside.
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
        Self { full, causes: &[], beside: None, lag_s: vehicle.motor_time_constant_s }
    }

    /// Draws another law for a cause of the catalogue. Winds need a drag in the vehicle file; with
    /// such a drag, no other drag is drawn.
    pub fn law(draw: &mut Draw, vehicle: &VehicleParams, has_drag: bool) -> Self {
        use EffectId::*;
        let weight = vehicle.mass * vehicle.gravity;
        let arm = airframe::arm_m(vehicle);
        let number =
            if has_drag { DRAGS + draw.below(LAWS + WINDS - DRAGS) } else { draw.below(LAWS) };
        let mut beside = None;
        let (full, causes): (Foreign, &[EffectId]) = match number {
            0 => {
                let exponent = rounded(draw.within([1.2, 1.8]));
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
            2 => {
                let quadratic = 0.6 * weight / 64.0;
                let shares = [1.0, draw.within([0.7, 1.4]), draw.within([1.0, 2.0])];
                let quadratic = shares.map(|share| rounded(share * quadratic));
                (Foreign::DragPlates { quadratic }, &[ParasiticDrag, RotorDrag])
            }
            3 => (Foreign::LagSecondOrder { tau_s: 0.5 * LAG_S }, &[MotorLag]),
            4 => {
                let down_s = rounded(LAG_S * draw.within([1.4, 2.0]));
                (Foreign::LagAsymmetric { up_s: LAG_S, down_s }, &[MotorLag])
            }
            5 => {
                let length = vehicle.rotor_radius_m * draw.within([1.5, 3.0]);
                (
                    Foreign::GroundExponential { gain: GROUND_GAIN, length_m: rounded(length) },
                    &[GroundEffect],
                )
            }
            6 => {
                let radius_m = rounded(10.0 * vehicle.rotor_radius_m);
                (Foreign::GroundPerRotor { radius_m }, &[GroundEffect])
            }
            7 => {
                let recovery_s = rounded(draw.within([1.0, 4.0]));
                (Foreign::SagRecovery { exponent: 2.5, recovery_s }, &[BatterySag])
            }
            8 => {
                let recovery_s = rounded(draw.within([0.5, 3.0]));
                (Foreign::SagAffine { slope: 2.5, recovery_s }, &[BatterySag])
            }
            9 => (Foreign::CurveCubic { b: 0.5 }, &[ThrustCurve]),
            10 => {
                let dead = rounded(draw.within([0.03, 0.1]));
                (Foreign::CurvePower { dead, power: 1.5 }, &[ThrustCurve])
            }
            11 => {
                let speed_m_s = rounded(draw.within([2.5, 5.0]));
                (Foreign::LiftSaturating { gain: 0.5, speed_m_s }, &[TranslationalLift])
            }
            12 => {
                let torque_share = rounded(draw.within([0.2, 0.6]));
                let rotor = draw.below(ROTORS);
                (Foreign::RotorWear { rotor, loss: 0.25, torque_share }, &[RotorLoss])
            }
            13 => {
                let full = Foreign::YawTorquePower {
                    by: draw.sign() * 0.8,
                    apart: rounded(draw.within([-0.1, 0.1])),
                    power: 1.0 + rounded(draw.within([-0.4, 0.4])),
                    hover_n: rounded(weight / ROTORS as f64),
                };
                (full, &[YawTorque])
            }
            14 => {
                beside = Some(Payload {
                    vehicle_kg: vehicle.mass,
                    share: PAYLOAD,
                    inertia: PAYLOAD_INERTIA,
                });
                let drag_ns_m = rounded(0.1 * vehicle.mass);
                let sunk_m = rounded(PAYLOAD_BELOW * arm);
                (Foreign::PayloadLever { drag_ns_m, sunk_m }, &[Mass, ThrustScale])
            }
            15 => {
                let direction = draw.within([0.0, TAU]);
                let full = Foreign::WindShear {
                    velocity_m_s: [direction.cos(), direction.sin()].map(|c| rounded(8.0 * c)),
                    exponent: rounded(draw.within([0.1, 0.25])),
                };
                (full, &[Wind])
            }
            _ => {
                let full = Foreign::GustEddies {
                    sigma_m_s: 4.0,
                    length_m: rounded(draw.log_within([5.0, 40.0])),
                    speed_m_s: rounded(draw.within([2.0, 6.0])),
                };
                (full, &[Gusts])
            }
        };
        Self { full, causes, beside, lag_s: vehicle.motor_time_constant_s }
    }

    /// The part that the catalogue can describe, at a size.
    pub fn effects(&self, size: f64) -> EffectSet {
        let mut effects = EffectSet::new();
        if let Some(Payload { vehicle_kg, share, inertia }) = self.beside {
            let mass_kg = rounded(vehicle_kg * (1.0 + size * share));
            let tilting = rounded(1.0 + size * inertia);
            let mut slots = Slots::default();
            slots[0] = mass_kg;
            // Values this small are accepted.
            let _ = effects.insert(EffectId::Mass, slots);
            let mut slots = Slots::default();
            slots[..3].copy_from_slice(&[tilting, tilting, 1.0]);
            let _ = effects.insert(EffectId::Inertia, slots);
        }
        effects
    }

    /// The rotor that it acts on, if it acts on a single one.
    pub fn rotor(&self) -> Option<usize> {
        match self.full {
            Foreign::RotorWear { rotor, .. } => Some(rotor),
            _ => None,
        }
    }

    /// The disturbance or law at a size.
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
            | Foreign::GroundExponential { gain: value, .. }
            | Foreign::Payload { share: value }
            | Foreign::SagRecovery { exponent: value, .. }
            | Foreign::GroundPerRotor { radius_m: value }
            | Foreign::SagAffine { slope: value, .. }
            | Foreign::LiftSaturating { gain: value, .. }
            | Foreign::RotorWear { loss: value, .. }
            | Foreign::GustEddies { sigma_m_s: value, .. }
            | Foreign::PayloadLever { sunk_m: value, .. }
            | Foreign::CurveCubic { b: value } => *value = by(*value),
            Foreign::CurvePower { dead, power } => {
                (*dead, *power) = (by(*dead), 1.0 + by(*power - 1.0));
            }
            Foreign::YawTorquePower { by: level, apart, power, .. } => {
                (*level, *apart, *power) = (by(*level), by(*apart), 1.0 + by(*power - 1.0));
            }
            Foreign::LagSecondOrder { tau_s } => *tau_s = rounded(0.5 * self.lag_s + by(*tau_s)),
            Foreign::Periodic { force_n: values, .. } | Foreign::Jet { force_n: values, .. } => {
                *values = values.map(by);
            }
            Foreign::DragPlates { quadratic } => *quadratic = quadratic.map(by),
            Foreign::DragBody { quadratic, cross } => {
                *quadratic = quadratic.map(by);
                *cross = by(*cross);
            }
            Foreign::LagAsymmetric { up_s, down_s } => {
                *up_s = rounded(self.lag_s + by(*up_s));
                *down_s = rounded(self.lag_s + by(*down_s));
            }
            Foreign::WindShear { velocity_m_s, .. } => *velocity_m_s = velocity_m_s.map(by),
        }
        sized
    }
}
