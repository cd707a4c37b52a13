//! The context of a diagnosis: flights, catalogue and on-board law, and simulators of explanations.

use vehicle::VehicleError;
use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::command_delay::MeasuredDelay;
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::flights::onboard::OnboardLaw;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::Evaluator;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::metric::Metric;
use crate::diagnose::simulate::open_loop::Simulator;

/// What the input's flights and vehicle file determine before any fit.
pub(super) struct Preliminaries {
    pub evaluator: Evaluator,
    /// Whether the on-board loop is known: all logs hold setpoints, and the vehicle file its law.
    pub is_loop_known: bool,
    /// The setpoints' delay, measured from the outputs.
    pub measured_delay: Option<MeasuredDelay>,
    /// Half a period of the outputs' reports, s.
    half_period_s: f64,
}

impl Preliminaries {
    /// Evaluates the preliminaries of a diagnosis.
    pub fn of(input: &DiagnosisInput<'_>) -> Self {
        let evaluator = Evaluator::new(input.vehicle).observing(input.fitted).until(input.stop);
        let has_setpoints = |flight: &PreparedFlight| flight.channels.setpoint;
        let is_loop_known = input.fitted.iter().chain(input.held_out).all(has_setpoints);
        let onboard = evaluator.onboard().filter(|_| is_loop_known);
        let is_shown = input.fitted.iter().all(|flight| flight.channels.shows_loop());
        let measured_delay =
            onboard.filter(|_| is_shown).and_then(|law| MeasuredDelay::of(input.fitted, law));
        // The stamp of an output is accurate to half a period of the reports.
        let rates = input.fitted.iter().map(|flight| flight.outputs.rate());
        let half_period_s = 0.5 / rates.fold(f64::INFINITY, f64::min);
        Self { evaluator, is_loop_known, measured_delay, half_period_s }
    }

    /// The law from setpoints to outputs, where all logs hold both.
    pub fn onboard(&self) -> Option<&OnboardLaw> {
        self.evaluator.onboard().filter(|_| self.is_loop_known)
    }

    /// The catalogue, with the tolerances that the vehicle file does not state multiplied by
    /// `scale`.
    pub fn catalogue(&self, input: &DiagnosisInput<'_>, scale: f64) -> Catalogue {
        let catalogue = Catalogue::at_scale(input.vehicle, self.is_loop_known, scale)
            .without(input.without)
            .with_outputs_held(self.half_period_s);
        match &self.measured_delay {
            Some(delay) => catalogue.with_delay(delay),
            None => catalogue,
        }
    }
}

/// The context of a diagnosis.
pub(super) struct DiagnosisContext<'a> {
    pub input: &'a DiagnosisInput<'a>,
    pub settings: &'a Settings,
    pub evaluator: &'a Evaluator,
    pub catalogue: &'a Catalogue,
    /// The law from setpoints to outputs, where all logs hold both.
    pub onboard: Option<&'a OnboardLaw>,
    /// The setpoints' delay, measured from the outputs.
    pub measured_delay: Option<MeasuredDelay>,
    /// Flights for fitting.
    pub fitted: Observed<'a>,
    /// Flights for choosing.
    pub choosing: Observed<'a>,
    /// Both together.
    pub all: Observed<'a>,
    /// Held-out flights, on which the answer reports the gap.
    pub reported: Observed<'a>,
    /// The metric of the predictions.
    pub metric: Metric,
    /// The axes about which the body's turning is compared: front, right, down.
    pub axes: [bool; 3],
}

impl DiagnosisContext<'_> {
    /// Whether the on-board loop is known: all logs hold setpoints, and the vehicle file its law.
    pub fn is_loop_known(&self) -> bool {
        self.onboard.is_some()
    }

    /// A simulator of the vehicle file with `effects` over it.
    pub fn simulator(&self, effects: &EffectSet) -> Result<Simulator, VehicleError> {
        let simulator = Simulator::new(self.input.vehicle, effects, self.is_loop_known())?;
        Ok(simulator.compared_by(self.metric, self.axes))
    }

    /// A simulator with some of an explanation's numbers: those of the effects `which`, and with
    /// `file` those of the vehicle file.
    pub fn simulator_of(
        &self,
        explanation: &Explanation,
        which: &[EffectId],
        file: bool,
    ) -> Result<Simulator, VehicleError> {
        let values = &explanation.fit.values;
        let own = self.effects_of(explanation);
        let (vehicle, all) = self.catalogue.vehicle_of(values);
        let mut effects = EffectSet::new();
        for (id, slots) in all.iter() {
            let is_in = if own.contains(&id) { which.contains(&id) } else { file };
            if is_in {
                // This insertion has succeeded before.
                let _ = effects.insert(id, *slots);
            }
        }
        let simulator = self.simulator(&effects)?;
        if file { simulator.with_vehicle(&vehicle, &effects) } else { Ok(simulator) }
    }

    /// The effects of an explanation, one for each of its hypotheses.
    pub fn effects_of(&self, explanation: &Explanation) -> Vec<EffectId> {
        let hypotheses = explanation.fit.hypotheses.iter();
        hypotheses.map(|h| self.catalogue.hypotheses[*h].effect).collect()
    }
}
