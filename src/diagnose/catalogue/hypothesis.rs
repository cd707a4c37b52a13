//! The catalogue as hypotheses, and the nuisances that are free in each of them.
//!
//! A vehicle file states each number of the physics to within a *tolerance*: the error of a careful
//! builder or a good identification. Within it the number is a nuisance, free in every hypothesis
//! under a prior of that width. An effect is named if its numbers must be further off; its
//! hypothesis replaces their tolerance by a wide prior.

use vehicle::effects::{EffectId, Neutral, Parameter};
use vehicle::{ROTORS, VehicleParams};

use crate::diagnose::catalogue::number::{CONTRASTS, Number, Target};
use crate::diagnose::catalogue::reference::{modelled_scale, reference};
use crate::diagnose::catalogue::term::Term;
use crate::diagnose::catalogue::tolerances::{
    DAMPING_RATE, DAMPING_TIME_S, Scales, Tolerances, VELOCITY_SMOOTHING_S2,
};
use crate::diagnose::flights::command_delay::MeasuredDelay;

/// Limit of a nuisance, in tolerances: anything further off is an effect.
pub const TOLERANCES_MAX: f64 = 3.0;

/// Limit of a law's coefficient, in its typical magnitudes.
const TERM_MAGNITUDES_MAX: f64 = 50.0;

/// Start values of delays, s. Setpoints may be synchronous with the loop, and the cost then has
/// many minima.
const DELAYS_S: [f64; 19] = [
    0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024, 0.028, 0.032, 0.036, 0.04, 0.044, 0.048, 0.052,
    0.056, 0.06, 0.066, 0.072, 0.08,
];
/// Start values of latencies, s. Interpolation averages noise between two samples, so the cost
/// ripples with the stream's period.
const LATENCIES_S: [f64; 32] = [
    0.0, 0.0025, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.0225, 0.025, 0.0275, 0.03,
    0.0325, 0.035, 0.0375, 0.04, 0.0425, 0.045, 0.0475, 0.05, 0.0525, 0.055, 0.0575, 0.06, 0.065,
    0.07, 0.075, 0.08, 0.09, 0.1, 0.12,
];
/// Start values of lags, s.
const MOTOR_LAGS_S: [f64; 6] = [0.004, 0.008, 0.015, 0.03, 0.06, 0.1];
/// Start values of the ground effect's effective radius, in rotor radii.
const GROUND_RADII: [f64; 3] = [2.0, 4.0, 8.0];
/// Start values of winds, north and east, m/s. Where drag grows with the square of the airspeed,
/// the cost of a hover has no slope in still air.
const WINDS_M_S: [f64; 8] = [1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, -1.0];
/// Bounds of the delay from a logged output to its thrust, s.
const OUTPUT_DELAYS_S: [f64; 2] = [-0.03, 0.15];

/// An effect as an explanation, or one of several ways that it may act.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// The effect that it stands for.
    pub effect: EffectId,
    /// Indices of its numbers.
    pub numbers: Vec<usize>,
    /// Start values for a fit, of its numbers and of nuisances that can substitute for them; the
    /// first start is the nearest.
    pub starts: Vec<Vec<(usize, f64)>>,
}

/// All numbers and hypotheses for one vehicle and the channels of its logs.
#[derive(Clone, Debug)]
pub struct Catalogue {
    /// The vehicle as shipped.
    pub vehicle: VehicleParams,
    /// Every number.
    pub numbers: Vec<Number>,
    /// Every hypothesis.
    pub hypotheses: Vec<Hypothesis>,
    /// Whether command_delay is the delay from a logged output to its thrust, because setpoints are
    /// missing.
    pub outputs_late: bool,
    /// Terms of a law, each with its coefficient among the numbers.
    pub terms: Vec<Term>,
}

/// Values of all numbers of a catalogue, by their index.
pub type Values = Vec<f64>;

impl Catalogue {
    /// The catalogue for a vehicle. `setpoint_leg`: setpoints and the on-board law are known, so
    /// command_delay and pd_gain act there. Otherwise command_delay is the delay from output to
    /// thrust.
    pub fn new(vehicle: &VehicleParams, setpoint_leg: bool) -> Self {
        Self::at_scale(vehicle, setpoint_leg, 1.0)
    }

    /// As [`new`](Self::new), with the tolerances that the vehicle file does not state multiplied
    /// by `scale`.
    pub fn at_scale(vehicle: &VehicleParams, setpoint_leg: bool, scale: f64) -> Self {
        let known = Tolerances::of(vehicle, scale);
        let mut catalogue = Self {
            vehicle: vehicle.clone(),
            numbers: Vec::new(),
            hypotheses: Vec::new(),
            outputs_late: false,
            terms: Vec::new(),
        };
        let scales = Scales::of(vehicle);
        let is_testable = |effect: &EffectId| match effect {
            EffectId::PdGain => setpoint_leg,
            EffectId::RotorGyroscopic => vehicle.rotor_max_rpm.is_some(),
            // Gusts are inferred from the residual force, not by regression.
            EffectId::Gusts => false,
            _ => true,
        };
        for effect in EffectId::ALL.into_iter().filter(is_testable) {
            match effect {
                EffectId::RotorLoss => catalogue.add_rotor_losses(&scales, &known),
                EffectId::CommandDelay if !setpoint_leg => catalogue.add_late_outputs(&known),
                _ => catalogue.add_effect(effect, &scales, &known),
            }
        }
        if setpoint_leg {
            catalogue.add_output_delay(&known);
        }
        catalogue.add_dampings();
        catalogue.add_imbalances(&known);
        catalogue.add_velocity_smoothing();
        catalogue
    }

    /// Adds an effect whose slots are its numbers.
    fn add_effect(&mut self, effect: EffectId, scales: &Scales, known: &Tolerances) {
        let mut numbers = Vec::new();
        for slot in effect.spec().slots() {
            let Some(known) = scales.of_slot(known, effect, slot.index) else { continue };
            let reference = reference(&self.vehicle, effect, slot.index);
            let target = Target::Effect(effect, slot.index);
            let bounds = bounds(effect, slot.parameter, reference, known.magnitude);
            let number = Number::new(target, reference, known, bounds);
            let quadratic = effect.spec().is_quadratic;
            numbers.push(self.add(Number { quadratic, ..number }));
        }
        let starts: Vec<&[f64]> = match effect {
            EffectId::EstimatorLatency => LATENCIES_S.chunks(1).collect(),
            EffectId::CommandDelay => DELAYS_S.chunks(1).collect(),
            EffectId::MotorLag => MOTOR_LAGS_S.chunks(1).collect(),
            EffectId::GroundEffect => GROUND_RADII.chunks(1).collect(),
            EffectId::Wind => WINDS_M_S.chunks(2).collect(),
            _ => Vec::new(),
        };
        self.hypothesis(effect, numbers, &starts);
    }

    /// Adds a loss of thrust of each rotor separately.
    fn add_rotor_losses(&mut self, scales: &Scales, known: &Tolerances) {
        let widths = [0.0, scales.typical(EffectId::RotorLoss, 1)];
        for rotor in 0..ROTORS {
            let reference = modelled_scale(&self.vehicle, rotor);
            let target = Target::RotorScale(rotor);
            let number = Number::nuisance(target, reference, widths, [0.05, 1.0]);
            let number = self.add(Number { unremarkable: known.rotor(), ..number });
            self.hypothesis(EffectId::RotorLoss, vec![number], &[]);
        }
    }

    /// Adds command_delay as the delay from a logged output to its thrust, because setpoints are
    /// missing.
    fn add_late_outputs(&mut self, known: &Tolerances) {
        let effect = EffectId::CommandDelay;
        let reference = reference(&self.vehicle, effect, 0);
        let widths = [known.output_delay(), 0.02];
        let number = Number::nuisance(Target::OutputDelay, reference, widths, OUTPUT_DELAYS_S);
        let number = self.add(number);
        self.hypothesis(effect, vec![number], &[&[0.01], &[0.03], &[0.06]]);
        self.outputs_late = true;
    }

    /// Adds the outputs' own delay, a nuisance beside command_delay.
    fn add_output_delay(&mut self, known: &Tolerances) {
        let widths = [known.output_delay(), 0.01];
        let delay = Number::nuisance(Target::OutputDelay, 0.0, widths, OUTPUT_DELAYS_S);
        let delay = self.add(delay);
        // A fit of the file's numbers alone may use this delay to explain a lag.
        for hypothesis in &mut self.hypotheses {
            if hypothesis.effect == EffectId::MotorLag {
                hypothesis.starts.iter_mut().for_each(|start| start.push((delay, 0.0)));
            }
        }
    }

    /// Adds a damping moment about each axis, a nuisance.
    fn add_dampings(&mut self) {
        for axis in 0..3 {
            let kp = self.vehicle.attitude_pd.map_or(0.0, |pd| pd.kp[axis]);
            let inertia = self.vehicle.inertia[axis];
            let tolerance = (DAMPING_TIME_S * kp).max(DAMPING_RATE * inertia);
            let bounds = [-10.0 * inertia, 10.0 * inertia];
            let widths = [tolerance, inertia];
            self.add(Number::nuisance(Target::Damping(axis), 0.0, widths, bounds));
        }
    }

    /// Adds differences between the rotors' thrusts, nuisances.
    fn add_imbalances(&mut self, known: &Tolerances) {
        for contrast in 0..CONTRASTS.len() {
            let widths = [known.rotor(), 0.2];
            self.add(Number::nuisance(Target::Imbalance(contrast), 0.0, widths, [-0.9, 0.9]));
        }
    }

    /// Adds the smoothing of the reported velocity, a nuisance.
    fn add_velocity_smoothing(&mut self) {
        let widths = [VELOCITY_SMOOTHING_S2; 2];
        let bounds = [0.0, TOLERANCES_MAX * VELOCITY_SMOOTHING_S2];
        self.add(Number::nuisance(Target::VelocitySmoothing, 0.0, widths, bounds));
    }

    /// Removes these effects and those that act alike. Their numbers stay free within their
    /// tolerances.
    pub fn without(mut self, effects: &[EffectId]) -> Self {
        let left_out =
            |h: &Hypothesis| effects.iter().any(|effect| h.effect.class() == effect.class());
        self.hypotheses.retain(|hypothesis| !left_out(hypothesis));
        self
    }

    /// Adds a number; returns its index.
    fn add(&mut self, number: Number) -> usize {
        self.numbers.push(number);
        self.numbers.len() - 1
    }

    /// Adds a hypothesis whose fits start at its references and at `starts`: values of its first
    /// numbers, in rotor radii for ground_effect. The references are left out where the cost has no
    /// slope at them.
    fn hypothesis(&mut self, effect: EffectId, numbers: Vec<usize>, starts: &[&[f64]]) {
        let at_reference: Vec<(usize, f64)> =
            numbers.iter().map(|i| (*i, self.numbers[*i].reference)).collect();
        let unit = if effect == EffectId::GroundEffect { self.vehicle.rotor_radius_m } else { 1.0 };
        let mut all = Vec::new();
        // The cost has no slope at 0 where the effect grows with the square of its number.
        if !effect.spec().is_quadratic || at_reference[0].1 > 0.0 {
            all.push(at_reference.clone());
        }
        for start in starts {
            let mut values = at_reference.clone();
            values.iter_mut().zip(*start).for_each(|((_, value), start)| *value = start * unit);
            all.push(values);
        }
        self.hypotheses.push(Hypothesis { effect, numbers, starts: all });
    }

    /// Widens the delay of the outputs where their stamps are accurate to `half_period_s` only.
    pub fn with_outputs_held(mut self, half_period_s: f64) -> Self {
        let delays = self.numbers.iter_mut().filter(|n| n.target == Target::OutputDelay);
        for number in delays {
            number.tolerance = number.tolerance.hypot(half_period_s);
            number.unremarkable = number.tolerance;
        }
        self
    }

    /// The catalogue with some numbers fixed at `values`.
    pub fn with_pinned(&self, numbers: &[usize], values: &[f64]) -> Self {
        let mut pinned = self.clone();
        for index in numbers {
            let number = &mut pinned.numbers[*index];
            (number.expected, number.tolerance) = (values[*index], 0.0);
        }
        pinned
    }

    /// Adds terms of a law, each with a coefficient whose prior width is the given magnitude.
    pub fn with_terms(&self, terms: Vec<(Term, f64)>) -> Self {
        let mut catalogue = self.clone();
        for (term, magnitude) in terms {
            let target = Target::Term(catalogue.terms.len());
            let most = TERM_MAGNITUDES_MAX * magnitude;
            catalogue.add(Number::nuisance(target, 0.0, [0.0, magnitude], [-most, most]));
            catalogue.terms.push(term);
        }
        catalogue
    }

    /// Index of the number for an effect's slot.
    pub fn number_of(&self, effect: EffectId, slot: usize) -> Option<usize> {
        self.numbers.iter().position(|number| number.target == Target::Effect(effect, slot))
    }

    /// The catalogue with command_delay as measured from the outputs: fits start only at its
    /// reference and at the measured value. If the reference's tolerance allows the value, it
    /// becomes the expected one. Otherwise the delay is known to be off, and is no nuisance.
    pub fn with_delay(mut self, delay: &MeasuredDelay) -> Self {
        let index = self.number_of(EffectId::CommandDelay, 0);
        let delays = self.hypotheses.iter_mut().filter(|h| h.effect == EffectId::CommandDelay);
        for hypothesis in delays {
            hypothesis.starts.truncate(1);
            hypothesis.starts.extend(index.map(|index| vec![(index, delay.mean)]));
        }
        if let Some(index) = index {
            let number = &mut self.numbers[index];
            let off = (delay.mean - number.reference).abs();
            if off < TOLERANCES_MAX * number.unremarkable {
                number.expected = delay.mean;
                number.tolerance = number.tolerance.min(delay.by_stamps);
            } else {
                number.tolerance = 0.0;
            }
        }
        self
    }

    /// The expected value of every number.
    pub fn expected(&self) -> Values {
        self.numbers.iter().map(|number| number.expected).collect()
    }

    /// The reference of every number.
    pub fn references(&self) -> Values {
        self.numbers.iter().map(|number| number.reference).collect()
    }

    /// Limits of a number, the lower one first: its bounds if it is active, else [`TOLERANCES_MAX`]
    /// tolerances about its expected value, within these bounds.
    pub fn limits(&self, number: usize, active: &[usize]) -> [f64; 2] {
        let Number { expected, tolerance, bounds: [low, high], .. } = self.numbers[number];
        if active.contains(&number) {
            return [low, high];
        }
        let width = TOLERANCES_MAX * tolerance;
        [expected - width, expected + width].map(|limit| limit.clamp(low, high))
    }

    /// Indices of the nuisances: the numbers with a tolerance.
    pub fn nuisances(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.numbers.len()).filter(|i| self.numbers[*i].tolerance > 0.0)
    }
}

/// Limit of an effect's number, in its typical magnitudes.
const MAGNITUDES_MAX: f64 = 5.0;

/// Bounds of a number. It must be physically possible (rotors flap away from the wind, and packs
/// sag as they empty) and plausible: no vehicle has a multiple of its file's inertia. The file's own
/// value is within them, even where the effect does not accept it.
fn bounds(effect: EffectId, parameter: &Parameter, reference: f64, magnitude: f64) -> [f64; 2] {
    let low = match effect {
        EffectId::BladeFlapping | EffectId::BatterySag => 0.0,
        _ => parameter.min,
    };
    let most = MAGNITUDES_MAX * magnitude;
    // A factor has symmetric bounds on a ratio scale.
    let [least, most] = match parameter.neutral {
        Neutral::Value(1.0) => [reference / (1.0 + most), reference * (1.0 + most)],
        _ => [reference - most, reference + most],
    };
    [low.max(least).min(reference), parameter.max.min(most).max(reference)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vehicle() -> VehicleParams {
        let text = include_str!("../../../config/vehicles/quad1200.toml");
        VehicleParams::from_toml_str(text).unwrap()
    }

    #[test]
    fn limits_stay_in_order_for_values_beyond_the_effects_ranges() {
        let mut vehicle = vehicle();
        vehicle.linear_drag_n_per_m_s = Some(1e3);
        vehicle.mass = 1e6;
        let latency = serde_json::json!({ "range_s": [20.0, 21.0] });
        vehicle.provenance.insert("pose_latency_s".to_owned(), latency);
        let catalogue = Catalogue::new(&vehicle, true);
        for (index, number) in catalogue.numbers.iter().enumerate() {
            let [low, high] = number.bounds;
            assert!((low..=high).contains(&number.reference), "{}: {low}..{high}", number.target);
            let [low, high] = catalogue.limits(index, &[]);
            assert!(low <= high, "{}: {low}..{high}", number.target);
        }
    }

    #[test]
    fn every_effect_except_gusts_is_a_hypothesis() {
        let catalogue = Catalogue::new(&vehicle(), true);
        for effect in EffectId::ALL {
            let found = catalogue.hypotheses.iter().filter(|h| h.effect == effect).count();
            let expected = match effect {
                EffectId::RotorLoss => ROTORS,
                EffectId::Gusts => 0,
                _ => 1,
            };
            assert_eq!(found, expected, "{effect}");
        }
    }

    #[test]
    fn excluding_an_effect_excludes_its_equivalence_class() {
        let whole = Catalogue::new(&vehicle(), true);
        let rest = whole.clone().without(&[EffectId::Mass, EffectId::Wind]);
        assert_eq!(rest.hypotheses.len(), whole.hypotheses.len() - 3);
        let left_out = [EffectId::Mass, EffectId::ThrustScale, EffectId::Wind];
        let considers = |effect: EffectId| rest.hypotheses.iter().any(|h| h.effect == effect);
        assert!(left_out.iter().all(|effect| !considers(*effect)));
        assert_eq!(rest.numbers.len(), whole.numbers.len());
    }

    #[test]
    fn wind_search_starts_cover_all_horizontal_directions() {
        let catalogue = Catalogue::new(&vehicle(), true);
        let wind = catalogue.hypotheses.iter().find(|h| h.effect == EffectId::Wind).unwrap();
        for slot in 0..2 {
            let tried = |sign: f64| wind.starts.iter().any(|start| sign * start[slot].1 > 0.5);
            assert!(tried(1.0) && tried(-1.0), "{:?}", wind.starts);
        }
        assert!(wind.starts.iter().all(|start| start.len() == 3 && start[2].1 == 0.0));
    }

    #[test]
    fn imbalances_keep_the_mean_thrust() {
        let vehicle = vehicle();
        let catalogue = Catalogue::new(&vehicle, true);
        let thrust = |vehicle: &VehicleParams| -> f64 {
            vehicle.rotors.iter().map(|rotor| rotor.thrust_max_n).sum()
        };
        for (index, number) in catalogue.numbers.iter().enumerate() {
            let Target::Imbalance(contrast) = number.target else { continue };
            let mut values = catalogue.references();
            values[index] = 0.03;
            let (moved, _) = catalogue.vehicle_of(&values);
            assert!((thrust(&moved) - thrust(&vehicle)).abs() < 1e-12);
            assert_ne!(moved.rotors[0].thrust_max_n, vehicle.rotors[0].thrust_max_n);
            for (other, shares) in CONTRASTS.iter().enumerate() {
                let product: f64 = CONTRASTS[contrast].iter().zip(shares).map(|(a, b)| a * b).sum();
                assert_eq!(product, f64::from(u8::from(other == contrast)));
            }
        }
    }

    #[test]
    fn reference_values_mean_no_effects() {
        let catalogue = Catalogue::new(&vehicle(), true);
        let references = catalogue.references();
        assert!(catalogue.effects(&references, None).is_empty());
        for (number, value) in catalogue.numbers.iter().zip(&references) {
            let [low, high] = number.bounds;
            assert!((low..=high).contains(value), "{number:?}");
        }
    }

    #[test]
    fn measured_delay_becomes_the_prior_within_file_tolerance() {
        let catalogue = Catalogue::new(&vehicle(), true);
        let index = catalogue.number_of(EffectId::CommandDelay, 0).unwrap();
        let Number { reference, tolerance, .. } = catalogue.numbers[index];
        let with = |off: f64| {
            let delay = MeasuredDelay { mean: reference + off, deviation: 7e-4, by_stamps: 1e-4 };
            let number = catalogue.clone().with_delay(&delay).numbers[index];
            [number.expected - reference, number.tolerance]
        };
        let [off, width] = with(0.001);
        assert!((off - 0.001).abs() < 1e-12 && width < tolerance);
        let [off, width] = with(0.005);
        assert!((off - 0.005).abs() < 1e-12 && width < tolerance);
        // A number that is off by more than the file's error is no nuisance.
        assert_eq!(with(0.008), [0.0, 0.0]);
    }

    #[test]
    fn nuisances_stay_in_tolerance_and_active_numbers_in_bounds() {
        let catalogue = Catalogue::new(&vehicle(), true);
        let target = Target::Effect(EffectId::Inertia, 0);
        let number = catalogue.numbers.iter().position(|n| n.target == target).unwrap();
        let [low, high] = catalogue.limits(number, &[]);
        assert!((low - 0.775).abs() < 1e-9 && (high - 1.225).abs() < 1e-9);
        assert_eq!(catalogue.limits(number, &[number]), catalogue.numbers[number].bounds);
    }
}
