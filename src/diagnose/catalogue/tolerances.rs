//! The accuracy of a vehicle file's numbers, and the typical size of effects, in a vehicle's own
//! units.

use serde_json::{Map, Value};
use vehicle::VehicleParams;
use vehicle::effects::EffectId;

/// Standard deviations of a vehicle file's numbers. They come from its `provenance`, or else are
/// those of a careful builder with a kitchen scale, a bifilar pendulum and one motor on a load
/// cell, times a scale estimated from the flights (0 for an exact file).
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Tolerances {
    thrust_common: f64,
    thrust_each: f64,
    mass: f64,
    inertia: f64,
    drag_torque: f64,
    lag_s: f64,
    centre_m: f64,
    delay_s: f64,
    attitude_rad: f64,
    latency_s: [f64; 2],
    gains: f64,
    /// Share of a drag, a sag or a thrust curve that the file models.
    modelled: f64,
    /// Largest drag that a file without one may omit, as a share of a typical one.
    small_drag: f64,
}

/// Timing errors of clocks and logs, whatever the file claims, s: of the rotors' lag, the
/// setpoints' delay, the latency of the pose, and the delay from a logged output to its thrust
/// (half a period of logs at 250 Hz).
const LAG_S: f64 = 0.001;
const DELAY_S: f64 = 0.0015;
const LATENCY_S: f64 = 0.0007;
const OUTPUT_DELAY_S: f64 = 0.002;
/// Accuracy of a delay measured from the outputs, s: the least delay of the downlink ties the
/// clocks, and may or may not include the link's jitter.
const DELAY_READ_S: f64 = 5.3e-4;
/// Standard deviation of air motion that a file does not mention, m/s.
const STILL_AIR_M_S: f64 = 0.03;
/// Tolerance of the variance of the times over which the reported velocity is smoothed, whatever the
/// file claims, s^2: three of these are a slope over 0.35 s.
pub(in crate::diagnose) const VELOCITY_SMOOTHING_S2: f64 = 0.0034;
/// Tolerance of the damping moment: a time that multiplies kp, and a rate in 1/s that multiplies
/// the inertia.
pub(in crate::diagnose) const DAMPING_TIME_S: f64 = 0.002;
pub(in crate::diagnose) const DAMPING_RATE: f64 = 0.1;
/// Tolerance of a number that its file calls assumed, relative to a measured one.
const ASSUMED: f64 = 4.0;

impl Tolerances {
    /// Tolerances of a vehicle file. Those that it does not state are a careful builder's times
    /// `scale`.
    pub fn of(vehicle: &VehicleParams, scale: f64) -> Self {
        let stated = Stated { provenance: &vehicle.provenance, scale };
        let arm = vehicle.arm_m();
        let lag = vehicle.motor_time_constant_s;
        let thrust = "rotors.thrust_max_N";
        let latency = stated.range("pose_latency_s");
        Self {
            thrust_common: stated.number(thrust, &["sigma_share_common", "sigma_share"], 0.02),
            thrust_each: stated.number(thrust, &["sigma_share_each", "sigma_share"], 0.015),
            mass: stated.number("mass", &["sigma_share"], 0.005),
            inertia: stated.number("inertia", &["sigma_share"], 0.075),
            drag_torque: stated.number("rotors.drag_torque_per_thrust_m", &["sigma_share"], 0.05),
            lag_s: stated.number("motor_time_constant_s", &["sigma_share"], 0.1) * lag,
            centre_m: stated.number("rotors.position_m", &["sigma_com_m"], 0.01 * arm),
            delay_s: stated.number("command_delay_s", &["sigma_s"], 0.002),
            attitude_rad: stated.number("attitude", &["sigma_rad"], 0.0087),
            latency_s: latency.unwrap_or([0.0, 0.0015 * scale]),
            gains: stated.number("attitude_pd", &["sigma_share"], 0.01),
            modelled: 0.05 * scale,
            small_drag: if vehicle.provenance.contains_key("rotor_drag") {
                0.5
            } else {
                0.5 * scale
            },
        }
    }

    /// Tolerance of the ratio of thrust to mass, a share: flights do not show which of the two is
    /// off.
    pub fn thrust_to_mass(&self) -> f64 {
        self.thrust_common.hypot(self.mass)
    }

    /// Tolerance of the level of the thrust: as above, with the mean error of the rotors.
    fn level(&self) -> f64 {
        self.thrust_to_mass().hypot(0.5 * self.thrust_each)
    }

    /// Tolerance of each rotor's thrust, a share.
    pub fn rotor(&self) -> f64 {
        self.thrust_each
    }

    /// Middle and deviation of the pose's latency beyond the file's, s.
    pub fn latency(&self) -> [f64; 2] {
        let [low, high] = self.latency_s;
        [0.5 * (low + high), (0.5 * (high - low)).max(LATENCY_S)]
    }

    /// Tolerance of the delay from a logged output to its thrust, s.
    pub fn output_delay(&self) -> f64 {
        OUTPUT_DELAY_S.hypot(self.delay_s)
    }
}

/// The errors that a file states for its numbers.
struct Stated<'a> {
    provenance: &'a Map<String, Value>,
    scale: f64,
}

impl Stated<'_> {
    /// The first of `keys` that the file states for the number `of`, else the scaled `usual`.
    fn number(&self, of: &str, keys: &[&str], usual: f64) -> f64 {
        let Some(of) = self.provenance.get(of) else { return usual * self.scale };
        let stated = keys.iter().find_map(|key| of.get(key)?.as_f64());
        let stated = stated.filter(|sigma| sigma.is_finite() && *sigma >= 0.0);
        stated.unwrap_or_else(|| {
            let says = |word: &str| of.to_string().to_lowercase().contains(word);
            if says("assumed") { usual * ASSUMED } else { usual * self.scale }
        })
    }

    /// The range that the file states for a number, s.
    fn range(&self, of: &str) -> Option<[f64; 2]> {
        let range = self.provenance.get(of)?.get("range_s")?;
        let [low, high] = [0, 1].map(|end| range.get(end).and_then(Value::as_f64));
        low.zip(high).filter(|(low, high)| low <= high && high.is_finite()).map(|(a, b)| [a, b])
    }
}

/// Typical sizes of effects for one vehicle.
pub(in crate::diagnose) struct Scales<'a> {
    vehicle: &'a VehicleParams,
    models_drag: bool,
}

/// Prior knowledge of a slot.
#[derive(Clone, Copy, Debug)]
pub(in crate::diagnose) struct Known {
    /// Expected value relative to the file's.
    pub offset: f64,
    /// Tolerance as a nuisance; 0 where only its effect changes it.
    pub tolerance: f64,
    /// Standard deviation that the file's errors give it: an effect is of practical size beyond
    /// three of these.
    pub unremarkable: f64,
    /// Typical magnitude where the effect occurs.
    pub magnitude: f64,
}

impl<'a> Scales<'a> {
    pub fn of(vehicle: &'a VehicleParams) -> Self {
        let effects = &vehicle.modelled_effects;
        let models_drag = vehicle.linear_drag_n_per_m_s.is_some()
            || effects.contains(EffectId::RotorDrag)
            || effects.contains(EffectId::ParasiticDrag);
        Self { vehicle, models_drag }
    }

    /// Typical size of a slot; 0 where it is not fitted.
    pub fn typical(&self, effect: EffectId, slot: usize) -> f64 {
        (effect.spec().typical)(self.vehicle).get(slot).copied().unwrap_or_default()
    }

    /// The file's modelled value of a slot.
    fn modelled(&self, effect: EffectId, slot: usize) -> Option<f64> {
        self.vehicle.modelled_effects.slots(effect)?.get(slot).copied()
    }

    /// Prior knowledge of a slot that may be fitted: the typical size of its effect, and the
    /// accuracy of the file where it states the number.
    pub fn of_slot(&self, known: &Tolerances, effect: EffectId, slot: usize) -> Option<Known> {
        use EffectId::*;
        let magnitude = self.typical(effect, slot);
        if magnitude == 0.0 {
            return None;
        }
        let modelled = |value: Option<f64>| value.map_or(0.0, |v| known.modelled * v.abs());
        // A file without drag may omit a small one; three deviations reach its limit.
        let left_out = if self.models_drag { 0.0 } else { known.small_drag / 3.0 * magnitude };
        let tolerance = match (effect, slot) {
            (ThrustScale, 0) => known.level(),
            (ThrustCurve | BatterySag, 0) => modelled(self.modelled(effect, 0)),
            (MotorLag, 0) => LAG_S.hypot(known.lag_s),
            (CommandDelay, 0) => DELAY_S.hypot(known.delay_s),
            // The exact linear drag replaces rotor_drag and follows another law.
            (RotorDrag, _) if self.vehicle.linear_drag_n_per_m_s.is_some() => 0.0,
            (RotorDrag | ParasiticDrag, _) => modelled(self.modelled(effect, slot)).max(left_out),
            (Wind, _) => STILL_AIR_M_S,
            (Inertia, _) => known.inertia,
            (ComOffset, _) => known.centre_m,
            (YawTorque, 0) => known.drag_torque,
            (AttitudeTrim, 0 | 1) => known.attitude_rad.max(1e-4),
            // Headings are not levelled by eye.
            (AttitudeTrim, 2) => (0.25 * known.attitude_rad).max(5e-4),
            (EstimatorLatency, 0) => known.latency()[1],
            (PdGain, _) => known.gains,
            // The file does not state it, or thrust_scale covers it.
            _ => 0.0,
        };
        let unremarkable = match effect {
            ThrustScale => known.thrust_to_mass(),
            CommandDelay => DELAY_READ_S.hypot(known.delay_s),
            Mass => known.thrust_to_mass() * self.vehicle.mass,
            _ => tolerance,
        };
        let offset = if effect == EstimatorLatency { known.latency()[0] } else { 0.0 };
        Some(Known { offset, tolerance, unremarkable, magnitude })
    }
}
